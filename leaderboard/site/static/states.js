/* Joint states of the truth (unless hidden) and of every method over time: one chart, one cursor, a click or arrow keys that seek. */

FreeArt.kinds.states = (section, data, bus) => {
  const { element, clamp } = FreeArt;
  const make = (tag, attributes) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    return node;
  };
  const factor = data.type === "revolute" ? 180 / Math.PI : 100, unit = data.type === "revolute" ? "°" : "cm";
  const curves = data.sources.filter(({ id }) => id === "truth" || data.methods[id])
    .map((source) => ({ ...source, on: true, values: (source.id === "truth" ? data.truth : data.methods[source.id]).map((q) => q * factor) }));
  const host = section.querySelector(".states"), times = data.times, n = times.length;
  const svg = make("svg", { role: "img", tabindex: 0, "aria-label": "joint state over time; left and right arrows step" });
  const legend = element("div", { class: "sources", role: "group", "aria-label": "whose curves are shown" });
  host.replaceChildren(svg, legend);
  let cursor = null, x = [], width = 0;

  const ticks = (low, high, about) => {
    const raw = (high - low) / about || 1, power = 10 ** Math.floor(Math.log10(raw));
    const size = power * [1, 2, 5, 10].find((m) => m * power >= raw * 0.999);
    const found = [];
    for (let k = Math.ceil(low / size); k * size <= high + 1e-9; k++) found.push(Math.round(k * size * 1e6) / 1e6);
    return found;
  };
  const draw = () => {
    width = Math.max(280, host.clientWidth);
    const height = width < 560 ? 210 : 260, left = 44, right = 12, top = 10, bottom = 30;
    const shown = curves.filter((curve) => curve.on);
    const truth = curves[0]?.values ?? [0], span = Math.max(...truth) - Math.min(...truth) || 1;
    /* The scale is the truth's, else the first method's, with room beside; who leaves it does so at the edge. */
    const [floor, roof] = [Math.min(...truth) - 0.75 * span, Math.max(...truth) + 0.75 * span];
    const all = (shown.length ? shown : curves.slice(0, 1)).flatMap((curve) => curve.values);
    const low = Math.max(floor, all.reduce((a, b) => Math.min(a, b), truth[0]) - 0.05 * span);
    const high = Math.min(roof, all.reduce((a, b) => Math.max(a, b), truth[0]) + 0.05 * span);
    x = times.map((t) => left + ((t - times[0]) / (times[n - 1] - times[0] || 1)) * (width - left - right));
    const y = (value) => top + ((high - clamp(value, low, high)) / (high - low)) * (height - top - bottom);
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    for (const [a, b] of data.gone)
      svg.append(make("rect", { class: "unseen", x: x[a], y: top, width: Math.max(1, x[b] - x[a]), height: height - top - bottom }));
    const label = (value, at, down, anchor) => {
      const text = make("text", { x: at, y: down, "text-anchor": anchor });
      text.textContent = value;
      svg.append(text);
    };
    for (const value of ticks(low, high, 6)) {
      svg.append(make("line", { class: "grid", x1: left, x2: width - right, y1: y(value), y2: y(value) }));
      label(value, left - 8, y(value) + 4, "end");
    }
    for (const t of ticks(times[0], times[n - 1], width < 560 ? 4 : 8))
      label(t, left + ((t - times[0]) / (times[n - 1] - times[0] || 1)) * (width - left - right), height - 10, "middle");
    for (const curve of shown) {
      const d = curve.values.map((value, i) => `${i ? "L" : "M"}${x[i].toFixed(1)} ${y(value).toFixed(1)}`).join("");
      svg.append(make("path", { d, stroke: curve.colour, class: curve.id === "truth" ? "truth" : "method",
        ...(curve.dash ? { "stroke-dasharray": curve.dash } : {}) }));
    }
    cursor = make("line", { class: "cursor", y1: top, y2: height - bottom });
    svg.append(cursor);
    update(bus.frame);
  };
  const update = (frame) => {
    const i = clamp(frame, 0, n - 1);
    cursor?.setAttribute("x1", x[i]);
    cursor?.setAttribute("x2", x[i]);
    for (const curve of curves) curve.output.textContent = `${curve.values[i].toFixed(1)} ${unit}`;
  };
  for (const curve of curves) {
    curve.output = element("output", {});
    const button = element("button", { type: "button", class: "chip", "aria-pressed": true });
    const line = make("svg", { viewBox: "0 0 26 8", class: "dash", "aria-hidden": "true" });
    line.append(make("path", { d: "M1 4h24", stroke: curve.colour, "stroke-width": curve.id === "truth" ? 5 : 2.4,
      ...(curve.dash ? { "stroke-dasharray": curve.dash } : {}) }));
    button.append(line, element("span", { class: "who" }, curve.name), curve.output);
    button.addEventListener("click", () => {
      curve.on = !curve.on;
      button.setAttribute("aria-pressed", curve.on);
      draw();
    });
    legend.append(button);
  }
  for (const source of data.sources)
    if (source.id !== "truth" && !data.methods[source.id])
      legend.append(element("span", { class: "chip absent" }, FreeArt.mark(source), element("span", { class: "who" }, source.name), element("small", {}, source.noStates)));
  const seek = (event) => {
    const box = svg.getBoundingClientRect(), at = ((event.clientX - box.left) / box.width) * width;
    let best = 0;
    for (let i = 1; i < n; i++) if (Math.abs(x[i] - at) < Math.abs(x[best] - at)) best = i;
    bus.show(best);
  };
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    seek(event);
  });
  svg.addEventListener("pointermove", (event) => { if (event.buttons) seek(event); });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    bus.show(clamp(bus.frame + step * Math.max(1, Math.round(n / 100)), 0, n - 1));
    event.preventDefault();
  });
  bus.on("frame", update);
  let drawn = 0;
  new ResizeObserver(() => requestAnimationFrame(() => {
    if (host.clientWidth !== drawn) draw();
    drawn = host.clientWidth;
  })).observe(host);
  draw();
};
