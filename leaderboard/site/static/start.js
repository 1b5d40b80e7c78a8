/* Bring every section to life. The data of a sequence page stands in a script of its own, packed. */

(async () => {
  const bus = FreeArt.makeBus();
  const sections = [...document.querySelectorAll("section[data-kind]")];
  const said = (section) => JSON.parse(section.querySelector('script[type="application/json"]')?.textContent ?? "{}");
  let packed = {};
  if (typeof FreeArtPacked !== "undefined") {
    if (typeof DecompressionStream === "undefined") {
      for (const section of sections)
        section.prepend(FreeArt.element("p", { class: "notice" }, "Video and 3D need a browser of 2023 or newer; all numbers stand below."));
      return;
    }
    packed = await FreeArt.unpack(FreeArtPacked);
  }
  for (const section of sections) {
    const kind = section.dataset.kind, data = { ...packed[kind], ...said(section) };
    if (kind === "player") Object.assign(data, { axes: packed.axes, poses: packed.axes.sources.truth && packed.scene.camera_poses, K: packed.scene?.camera.K });
    if (kind === "scene") FreeArt.prepareScene(data, packed);
    FreeArt.kinds[kind]?.(section, data, bus);
  }
  document.documentElement.dataset.ready = "yes";
})();

/** Make of the packed scene what the 3D view reads: arrays, arrows, names, one camera pose a frame of the video. */
FreeArt.prepareScene = (data, packed) => {
  data.surfaces = data.surfaces.filter(({ mesh, arrow }) => mesh || arrow)
    .map(({ mesh, arrow, ...rest }) => ({ ...rest, ...(mesh ?? FreeArt.arrow(arrow)), colours: null, uv: null, texture: -1 }));
  const frames = packed.player.frames, last = frames[frames.length - 1];
  const poses = data.camera_poses;
  data.camera_poses = [];
  for (let frame = 0, k = 0; frame <= last; frame++) {
    while (k + 1 < frames.length && Math.abs(frames[k + 1] - frame) < Math.abs(frames[k] - frame)) k++;
    data.camera_poses.push(poses[k]);
  }
  const roots = data.links.flatMap(({ parent }, i) => (parent === -1 ? [i] : []));
  for (const way of data.arrangements) way.roots = roots;
  data.layers.forEach((layer, i) => { if (i % 2 === 0) Object.assign(layer, data.sources[i / 2]); });
  data.labels = roots.map((link, k) => {
    const down = data.up.map((u, i) => data.centre[i] - 0.66 * data.radius * u);
    return { text: data.layers[2 * k].name, link, at: down };
  });
};
