/* Small charts in step with the video: one cursor in all of them, the values there in the legends, a click that seeks. */

FreeArt.kinds.curves = (section, data, bus) => {
  const charts = [...section.querySelectorAll("figure")].map((figure, c) => ({
    svg: figure.querySelector("svg"),
    cursor: figure.querySelector(".cursor"),
    outputs: figure.querySelectorAll("output"),
    series: data.charts[c],
  }));
  const digits = (value) => (value >= 100 ? value.toFixed(0) : value >= 1 ? value.toFixed(1) : value.toFixed(3));
  const update = (frame) => {
    const i = FreeArt.clamp(frame, 0, data.x.length - 1);
    for (const { cursor, outputs, series } of charts) {
      cursor.setAttribute("x1", data.x[i]);
      cursor.setAttribute("x2", data.x[i]);
      outputs.forEach((output, k) => { output.textContent = series[k][i] === null ? "–" : digits(series[k][i]); });
    }
  };
  for (const { svg } of charts) FreeArt.seekable(svg, data, bus);
  bus.on("frame", update);
  update(0);
};

/* The list of what to distrust: a click on the frames shows them. */

FreeArt.kinds.remarks = (section, data, bus) => {
  for (const button of section.querySelectorAll("button[data-frame]"))
    button.addEventListener("click", () => bus.show(Number(button.dataset.frame)));
};
