/* The video player of a result or a sequence: images, with the labels of the estimated and true parts, pixel by pixel. */

FreeArt.kinds.video = (section, data, bus) => {
  const { element } = FreeArt, { width, height, axes } = data;
  const times = data.times_s ?? data.frames.map((frame) => frame / 30);
  const images = { rgb: FreeArt.images(data.rgb ?? []), depth: FreeArt.images(data.depth ?? []), labels: FreeArt.images(data.labels) };
  let slot = 0, picture = data.rgb ? "rgb" : "none", parts = data.estimate ? "found" : data.truth ? "truth" : "off";
  let opacity = 0.4, axisShown = axes.length > 0, doubtShown = false;

  const panes = [["found", "estimate"], ["truth", "ground truth"]].map(([name, caption]) => {
    const canvas = element("canvas", { width, height });
    return { name, pane: element("figure", {}, canvas, element("figcaption", {}, caption)), context: canvas.getContext("2d") };
  });
  const scratch = element("canvas", { width, height }).getContext("2d", { willReadFrequently: true });

  /* Labels over one pane, from a channel of their image: the foreground in white, or the parts with their outlines. */
  const rgbOf = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  const palette = data.colours.map(rgbOf), unsure = rgbOf("#e4002b");
  const paint = (context, channel, style) => {
    images.labels.draw(scratch, slot, width, height);
    const pixels = scratch.getImageData(0, 0, width, height), bytes = pixels.data;
    const label = new Uint8Array(width * height), doubtful = doubtShown && channel === 1;
    for (let i = 0; i < label.length; i++) label[i] = Math.floor(bytes[4 * i + channel] / 100 + 0.1);
    const edge = Math.max(1, Math.round(width / 400));
    for (let i = 0, y = 0; y < height; y++) {
      for (let x = 0; x < width; x++, i++) {
        const value = label[i];
        const doubt = doubtful && value ? FreeArt.clamp(2 - (bytes[4 * i + channel] - 100 * value) / 20, 0, 1) : 0;
        bytes[4 * i + 3] = 0;
        if (!value) continue;
        const rim = (x < edge || label[i - edge] !== value) || (x >= width - edge || label[i + edge] !== value)
          || (y < edge || label[i - edge * width] !== value) || (y >= height - edge || label[i + edge * width] !== value);
        const colour = style === "foreground" ? [255, 255, 255] : palette[value - 1];
        for (let c = 0; c < 3; c++) bytes[4 * i + c] = (1 - doubt) * colour[c] + doubt * unsure[c];
        const alpha = style === "solid" ? Math.max(opacity, 0.85) : opacity + doubt * Math.max(0, 0.85 - opacity);
        bytes[4 * i + 3] = style === "foreground" || rim ? 255 : 255 * alpha;
      }
    }
    scratch.putImageData(pixels, 0, 0);
    context.drawImage(scratch.canvas, 0, 0);
    scratch.clearRect(0, 0, width, height);
  };

  let wanted = 0;
  const draw = async () => {
    const ticket = ++wanted, layers = [picture, "labels"].filter((kind) => images[kind]);
    await Promise.all(layers.map((kind) => images[kind].ready(slot)));
    if (ticket !== wanted) return;
    for (const { name, context, pane } of panes) {
      pane.hidden = parts !== "beside" && name !== (parts === "truth" ? "truth" : "found");
      if (pane.hidden) continue;
      context.fillStyle = picture === "foreground" ? "#14181c" : "#e9edf0";
      context.fillRect(0, 0, width, height);
      images[picture]?.draw(context, slot, width, height);
      if (picture === "foreground") paint(context, 0, "foreground");
      if (parts !== "off") paint(context, name === "truth" ? 2 : 1, data.rgb ? "clear" : "solid");
      for (const { name: of, colour, ends } of axisShown ? axes : [])
        if (ends[slot] && (of === "truth" || name === "found")) FreeArt.drawArrow(context, ends[slot], colour, Math.max(2, width / 210));
    }
    for (let ahead = 1; ahead < 4; ahead++) for (const kind of layers) images[kind].load((slot + ahead) % data.frames.length);
  };
  const clock = FreeArt.clock(bus, data.frames, times, (now) => {
    slot = now;
    draw();
  }, (i) => (data.times_s ? ` · ${times[i].toFixed(2)} s` : "") + (data.states ? ` · ${FreeArt.stateText(data.joint_type, data.states[i])}` : ""));

  /* Legends and controls. */
  const entry = (colour, text, line = "") => {
    const mark = element("i", { class: line });
    mark.style.background = colour;
    return element("li", {}, mark, text);
  };
  const legendDoubt = entry("#e4002b", "uncertain label");
  legendDoubt.title = "full red: probability of one half or less";
  const legendParts = element("ul", { class: "legend" },
    ...["reference part", "moving part"].map((text, k) => entry(data.colours[k], text)),
    ...axes.map(({ name, colour }) => entry(colour, name === "truth" ? "true axis" : "joint axis", "line")), legendDoubt);
  const bar = element("span", { class: "bar" });
  if (data.depth_colours) bar.style.background = `linear-gradient(to right, ${data.depth_colours.join(",")})`;
  const [near, far] = data.depth_range_m.map((metres) => `${metres.toFixed(2)} m`);
  const legendDepth = element("p", { class: "legend" }, near, bar, far);
  const redraw = () => {
    legendParts.hidden = strength.hidden = parts === "off";
    legendDoubt.hidden = !doubtShown;
    legendDepth.hidden = picture !== "depth";
    draw();
  };
  const pictures = [["rgb", "RGB"], ["depth", "Depth"], ["foreground", "Foreground"]];
  const pictureChoice = FreeArt.choice("image", data.rgb ? pictures : [], picture, (value) => {
    picture = value;
    redraw();
  });
  const options = [["off", "Off"], ["found", "Estimate"], ["truth", "Ground truth"], ["beside", "Side by side"]]
    .filter(([value]) => ({ off: true, found: data.estimate, truth: data.truth, beside: data.estimate && data.truth })[value]);
  const partsChoice = FreeArt.choice("parts", options, parts, (value) => {
    parts = value;
    stage.classList.toggle("beside", parts === "beside");
    redraw();
  });
  const strength = FreeArt.percentage("Opacity", "opacity of the parts", 100 * opacity, (value) => {
    opacity = value / 100;
    draw();
  });
  const axis = FreeArt.checkBox("Axis", axisShown, (shown) => {
    axisShown = shown;
    draw();
  });
  const doubt = FreeArt.checkBox("Label uncertainty", false, (shown) => {
    doubtShown = shown;
    redraw();
  });
  const named = (name, choice) => element("div", {}, element("span", { class: "label" }, name), choice);
  const stage = element("div", { class: "stage" }, ...panes.map(({ pane }) => pane));
  section.querySelector(".player").append(stage, clock.row,
    element("div", { class: "controls" },
      ...(data.rgb ? [named("Image", pictureChoice)] : []),
      ...(options.length > 1 ? [named("Parts", partsChoice), strength] : []),
      ...(data.confidence ? [doubt.label] : []),
      ...(axes.length ? [axis.label] : []),
      clock.speed),
    legendParts, legendDepth);
  bus.on("link", (link) => {
    if (link.doubt && data.confidence) doubt.box.checked = doubtShown = link.doubt !== "off";
    if (link.axis && axes.length) axis.box.checked = axisShown = link.axis !== "off";
    if (link.picture) pictureChoice.set(link.picture);
    if (link.parts) partsChoice.set(link.parts);
    redraw();
  });
  redraw();
  bus.show(0);
};
