/* The player of a sequence: its video with the parts of the ground truth and of every method as outlines and colours. */

/** The contour at 0.5 of the smoothed mask of one label, as a path over the unit square (marching squares). */
FreeArt.outline = (map, w, h, label) => {
  const stride = w + 2, value = new Float32Array(stride * (h + 2)), smooth = new Float32Array(value.length);
  for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) value[(y + 1) * stride + x + 1] = map[y * w + x] === label ? 1 : 0;
  for (let y = 1; y <= h; y++)
    for (let x = 1; x <= w; x++) {
      const i = y * stride + x;
      smooth[i] = (4 * value[i] + 2 * (value[i - 1] + value[i + 1] + value[i - stride] + value[i + stride])
        + value[i - stride - 1] + value[i - stride + 1] + value[i + stride - 1] + value[i + stride + 1]) / 16;
    }
  /* Every crossing of a grid edge has a key. Segments keep the inside on their left, so each key has one successor. */
  const places = new Map(), next = new Map(), path = new Path2D();
  const key = (x0, y0, x1, y1) => {
    const name = (y0 * stride + x0) * 2 + (y1 !== y0 ? 1 : 0);
    if (!places.has(name)) {
      const a = smooth[y0 * stride + x0], t = (0.5 - a) / (smooth[y1 * stride + x1] - a);
      places.set(name, [(x0 + t * (x1 - x0) - 0.5) / w, (y0 + t * (y1 - y0) - 0.5) / h]);
    }
    return name;
  };
  for (let y = 0; y <= h; y++)
    for (let x = 0; x <= w; x++) {
      const i = y * stride + x;
      const code = (smooth[i] > 0.5 ? 1 : 0) | (smooth[i + 1] > 0.5 ? 2 : 0) | (smooth[i + stride + 1] > 0.5 ? 4 : 0)
        | (smooth[i + stride] > 0.5 ? 8 : 0);
      if (code === 0 || code === 15) continue;
      const edges = { T: [x, y, x + 1, y], R: [x + 1, y, x + 1, y + 1], B: [x, y + 1, x + 1, y + 1], L: [x, y, x, y + 1] };
      for (const [from, to] of SEGMENTS[code]) next.set(key(...edges[from]), key(...edges[to]));
    }
  while (next.size) {
    const start = next.keys().next().value;
    let at = start, first = true;
    do {
      const [x, y] = places.get(at);
      if (first) path.moveTo(x, y); else path.lineTo(x, y);
      first = false;
      const to = next.get(at);
      next.delete(at);
      at = to;
    } while (at !== undefined && at !== start);
    path.closePath();
  }
  return path;
};
/* By which corners are inside (1 upper left, 2 upper right, 4 lower right, 8 lower left): edges crossed, from and to. */
const SEGMENTS = ["", "LT", "TR", "LR", "RB", "LT RB", "TB", "LB", "BL", "BT", "TR BL", "BR", "RL", "RT", "TL", ""]
  .map((text) => text.split(" ").filter(Boolean));

FreeArt.kinds.overlays = (section, data, bus) => {
  const { element } = FreeArt, { frames, times, width, height } = data;
  const canvas = element("canvas", { tabindex: 0, role: "application",
    "aria-label": "video with the parts of every method; space plays, left and right arrows step" });
  canvas.style.aspectRatio = `${width} / ${height}`;
  const context = canvas.getContext("2d"), images = FreeArt.images(data.sheets, data.across, data.down);
  let slot = 0, strength = 0.35, axisShown = true;
  const sources = data.sources.map((source) => ({ ...source, maps: null, paths: [], on: Boolean(source.masks) && source.first }));
  const paths = (source, k) => {
    const { width: w, height: h } = source.masks;
    source.maps ??= FreeArt.labelMaps(source.masks);
    return (source.paths[k] ??= [1, 2].map((label) => FreeArt.outline(source.maps[k], w, h, label)));
  };

  const drawParts = (source, w, h, line) => {
    const outlines = paths(source, slot).map((path) => {
      const scaled = new Path2D();
      scaled.addPath(path, new DOMMatrix([w, 0, 0, h, 0, 0]));
      return scaled;
    });
    context.lineJoin = "round";
    context.fillStyle = source.colour;
    outlines.forEach((path, part) => {
      context.globalAlpha = Math.min(1, [0.4, 1.4][part] * strength);
      context.fill(path, "evenodd");
      context.globalAlpha = 1;
    });
    outlines.forEach((path, part) => {
      context.setLineDash(part ? [] : [3 * line, 2 * line]);
      for (const [style, thick] of [["#ffffffb0", part ? 2 * line : 0], [source.colour, line]]) {
        context.strokeStyle = style;
        context.lineWidth = thick;
        if (thick) context.stroke(path);
      }
    });
    context.setLineDash([]);
  };
  let waiting = false;
  const draw = async () => {
    waiting = false;
    await images.ready(slot);
    const scale = Math.min(2, devicePixelRatio || 1);
    const w = Math.round(canvas.clientWidth * scale), h = Math.round((w * height) / width);
    if (!w) return;
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    context.fillStyle = "#8b9096";
    context.fillRect(0, 0, w, h);
    images.draw(context, slot, w, h);
    images.load((slot + data.across * data.down) % frames.length);
    const line = Math.max(1.5, w / 420), shown = sources.filter(({ on }) => on);
    for (const source of shown) if (source.masks) drawParts(source, w, h, line);
    for (const { axis, colour } of axisShown ? shown : [])
      if (axis?.[slot]) FreeArt.drawArrow(context, axis[slot].map((x) => (x * w) / width), colour, 1.8 * line);
  };
  const redraw = () => {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  };
  const clock = FreeArt.clock(bus, frames, times, (now) => {
    slot = now;
    redraw();
  }, (i) => ` · ${times[i].toFixed(2)} s`);
  canvas.addEventListener("click", () => clock.play.click());

  const chips = element("div", { class: "sources", role: "group", "aria-label": "whose parts are shown" },
    ...sources.map((source) => FreeArt.toggle({ class: "chip", disabled: !source.masks && !source.axis }, source.on, (on) => {
      source.on = on;
      redraw();
    }, FreeArt.mark(source), element("span", { class: "who" }, source.name), ...(source.masks ? [] : [element("small", {}, source.why || "no masks")]))));
  const axis = FreeArt.checkBox("Joint axes", true, (shown) => {
    axisShown = shown;
    redraw();
  });
  const opacity = FreeArt.percentage("Opacity", "opacity of the parts", 50, (value) => {
    strength = (0.7 * value) / 100;
    redraw();
  });
  section.querySelector(".stage").replaceChildren(canvas);
  section.querySelector(".player").append(clock.row, chips, element("div", { class: "controls" }, opacity, axis.label, clock.speed));
  new ResizeObserver(redraw).observe(canvas);
  clock.show(0);
};

/** An SVG of 16 x 16 with the path `shape` in its colour: the mark of a method or of the ground truth. */
FreeArt.mark = ({ shape, colour }) => {
  const make = (tag, attributes) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    return node;
  };
  const svg = make("svg", { viewBox: "0 0 16 16", class: "mark", "aria-hidden": "true" });
  svg.append(make("path", { d: shape, fill: colour }));
  return svg;
};
