/* The state plot: a cursor at the current frame, and a click or drag that moves the video. */

FreeArt.kinds.plot = (section, data, bus) => {
  const svg = section.querySelector("svg"), cursor = section.querySelector(".cursor");
  const readout = FreeArt.element("li", { class: "value" });
  section.querySelector(".legend").append(readout);
  const update = (frame) => {
    const i = FreeArt.clamp(frame, 0, data.x.length - 1);
    cursor.setAttribute("x1", data.x[i]);
    cursor.setAttribute("x2", data.x[i]);
    const values = [["found", data.found], ["truth", data.truth]].filter(([, series]) => series)
      .map(([name, series]) => `${name} ${FreeArt.stateText(data.type, series[i])}`);
    readout.textContent = `frame ${i}: ${values.join(", ")}`;
  };
  FreeArt.seekable(svg, data, bus);
  bus.on("frame", update);
  update(0);
};

/** Clicking or dragging in a drawing `data.width` wide moves the video to the nearest frame of `data.x`. */
FreeArt.seekable = (svg, data, bus) => {
  const seek = (event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * data.width;
    let best = 0;
    for (let i = 1; i < data.x.length; i++) if (Math.abs(data.x[i] - x) < Math.abs(data.x[best] - x)) best = i;
    bus.show(best);
  };
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    seek(event);
  });
  svg.addEventListener("pointermove", (event) => {
    if (event.buttons) seek(event);
  });
};
