/* Plots over the frames: a cursor in all of them, the values there in the legends; a click, drag or arrow key seeks. */

FreeArt.kinds.curves = (section, data, bus) => {
  const frames = data.frames ?? data.x.map((_, i) => i);
  const charts = [...section.querySelectorAll("figure")].map((figure, c) => ({
    svg: figure.querySelector("svg"),
    cursor: figure.querySelector(".cursor"),
    outputs: figure.querySelectorAll("output"),
    series: data.charts[c],
  }));
  const text = (value) => {
    const size = Math.abs(value);
    return value === null ? "–" : size < 5e-4 ? "0" : value.toFixed(size >= 100 ? 0 : size >= 1 ? 1 : 3);
  };
  let at = 0;
  const update = (frame) => {
    at = FreeArt.nearest(frames, frame);
    for (const { cursor, outputs, series } of charts) {
      cursor.setAttribute("x1", data.x[at]);
      cursor.setAttribute("x2", data.x[at]);
      outputs.forEach((output, k) => { output.textContent = text(series[k][at]); });
    }
  };
  const show = (i) => bus.show(frames[FreeArt.clamp(i, 0, frames.length - 1)]);
  for (const { svg } of charts) {
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
    /* Entries of a legend that are buttons hide and show their curves. */
    const curves = svg.querySelectorAll("g");
    svg.parentElement.querySelectorAll(".legend button").forEach((button, k) => {
      button.addEventListener("click", () => {
        curves[k].classList.toggle("hidden");
        button.setAttribute("aria-pressed", !curves[k].classList.contains("hidden"));
      });
    });
  }
  bus.on("frame", update);
  update(0);
};

/* Warnings: a click on the frames shows them. */
FreeArt.kinds.remarks = (section, data, bus) => {
  for (const button of section.querySelectorAll("button[data-frame]"))
    button.addEventListener("click", () => bus.show(Number(button.dataset.frame)));
};
