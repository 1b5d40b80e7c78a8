/* Plots over the frames: a cursor in all of them, the values there in the legends; a click, drag or arrow key seeks. */

FreeArt.kinds.curves = (section, data, bus) => {
  const frames = data.frames ?? data.x.map((_, i) => i);
  const text = (value) => {
    const size = Math.abs(value);
    return value === null ? "–" : size < 5e-4 ? "0" : value.toFixed(size >= 100 ? 0 : size >= 1 ? 1 : 3);
  };
  let at = 0;
  const show = (i) => bus.show(frames[FreeArt.clamp(i, 0, frames.length - 1)]);
  const updates = [...section.querySelectorAll("figure")].map((figure, c) => {
    const svg = figure.querySelector("svg"), cursor = svg.querySelector(".cursor"), curves = svg.querySelectorAll("g");
    const seek = (event) => {
      const box = svg.getBoundingClientRect();
      show(FreeArt.nearest(data.x, ((event.clientX - box.left) / box.width) * data.width));
    };
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      seek(event);
    });
    svg.addEventListener("pointermove", (event) => { if (event.buttons) seek(event); });
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step) return;
      show(at + step * Math.max(1, Math.round(frames.length / 100)));
      event.preventDefault();
    });
    figure.querySelectorAll(".legend button").forEach((button, k) => FreeArt.toggle(button, (on) => curves[k].classList.toggle("hidden", !on)));
    const outputs = figure.querySelectorAll("output");
    return () => {
      cursor.setAttribute("x1", data.x[at]);
      cursor.setAttribute("x2", data.x[at]);
      outputs.forEach((output, k) => { output.textContent = text(data.charts[c][k][at]); });
    };
  });
  const update = (frame) => {
    at = FreeArt.nearest(frames, frame);
    for (const one of updates) one();
  };
  bus.on("frame", update);
  update(0);
};
