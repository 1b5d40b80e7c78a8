/* The video with what truth and every method say of it: outlines and colours of their parts, and their joint axes. */

FreeArt.kinds.player = (section, data, bus) => {
  const { element, clamp } = FreeArt;
  const { frames, times, width, height, across, down } = data;
  const n = frames.length, ratio = height / width;
  const canvas = element("canvas", { tabindex: 0, role: "application", "aria-label":
    "video with the parts that were found; space plays, left and right arrows step" });
  canvas.style.aspectRatio = `${width} / ${height}`;
  const context = canvas.getContext("2d");
  let slot = 0, strength = 0.35, axes = true;

  /* Sheets of pictures, fetched when needed. */
  const sheets = data.sheets.map((address) => ({ address, image: null }));
  const sheet = (k) => {
    const one = sheets[k];
    if (one && !one.image) {
      one.image = new Image();
      one.image.addEventListener("load", () => draw());
      one.image.src = one.address;
    }
    return one?.image;
  };

  /* Outlines: the 0.5 contour of the smoothed label map, by marching squares; made once a frame and source. */
  const outline = (map, w, h, label) => {
    const value = new Float32Array((w + 2) * (h + 2)), smooth = new Float32Array(value.length);
    for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) value[(y + 1) * (w + 2) + x + 1] = map[y * w + x] === label ? 1 : 0;
    const stride = w + 2;
    for (let y = 1; y <= h; y++)
      for (let x = 1; x <= w; x++) {
        const i = y * stride + x;
        smooth[i] = (4 * value[i] + 2 * (value[i - 1] + value[i + 1] + value[i - stride] + value[i + stride])
          + value[i - stride - 1] + value[i - stride + 1] + value[i + stride - 1] + value[i + stride + 1]) / 16;
      }
    const path = new Path2D(), next = new Map();
    const point = (x0, y0, x1, y1) => {
      const a = smooth[y0 * stride + x0], b = smooth[y1 * stride + x1];
      const t = (0.5 - a) / (b - a);
      return [(x0 + t * (x1 - x0) - 0.5) / w, (y0 + t * (y1 - y0) - 0.5) / h];
    };
    /* Every crossing has a key; segments keep the inside on their left, so that each key has one way in and one out. */
    const places = new Map();
    const key = (x0, y0, x1, y1) => {
      const name = (y0 * stride + x0) * 2 + (y1 !== y0 ? 1 : 0);
      if (!places.has(name)) places.set(name, point(x0, y0, x1, y1));
      return name;
    };
    for (let y = 0; y <= h; y++)
      for (let x = 0; x <= w; x++) {
        const i = y * stride + x;
        const code = (smooth[i] > 0.5 ? 1 : 0) | (smooth[i + 1] > 0.5 ? 2 : 0) | (smooth[i + stride + 1] > 0.5 ? 4 : 0)
          | (smooth[i + stride] > 0.5 ? 8 : 0);
        if (code === 0 || code === 15) continue;
        const top = () => key(x, y, x + 1, y), left = () => key(x, y, x, y + 1);
        const right = () => key(x + 1, y, x + 1, y + 1), bottom = () => key(x, y + 1, x + 1, y + 1);
        const add = (from, to) => next.set(from(), to());
        ({ 1: () => add(left, top), 2: () => add(top, right), 3: () => add(left, right), 4: () => add(right, bottom),
          5: () => { add(left, top); add(right, bottom); }, 6: () => add(top, bottom), 7: () => add(left, bottom),
          8: () => add(bottom, left), 9: () => add(bottom, top), 10: () => { add(top, right); add(bottom, left); },
          11: () => add(bottom, right), 12: () => add(right, left), 13: () => add(right, top), 14: () => add(top, left) })[code]();
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

  /* Sources: the truth and every method, those that show nothing with the reason. */
  const sources = data.sources.map((source) => {
    const packed = data.masks[source.id];
    return { ...source, packed, maps: null, paths: [], on: Boolean(packed) && source.first, axis: data.axes.sources[source.id] };
  });
  const paths = (source, k) => {
    source.maps ??= FreeArt.labelMaps(source.packed);
    source.paths[k] ??= [1, 2].map((label) => outline(source.maps[k], source.packed.width, source.packed.height, label));
    return source.paths[k];
  };

  /* Where an axis stands in a picture: by the true pose of the reference part, in whose frame all joints are told; where
     the truth is hidden, by the answer's own. */
  const project = (point, T) => {
    const p = T.map((row) => row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]);
    return p[2] > 1e-6 ? [(data.K[0][0] * p[0]) / p[2] + data.K[0][2], (data.K[1][1] * p[1]) / p[2] + data.K[1][2]] : null;
  };
  const axisEnds = ({ type, axis, pivot }, poses) => {
    const near = data.axes.near, dot = axis.reduce((sum, a, k) => sum + a * (near[k] - pivot[k]), 0);
    const at = type === "prismatic" ? near : pivot.map((p, k) => p + dot * axis[k]);
    return [-0.6, 0.6].map((t) => project(at.map((p, k) => p + t * data.axes.size * axis[k]), poses[slot]));
  };

  const draw = () => {
    const scale = Math.min(2, devicePixelRatio || 1);
    const w = Math.round(canvas.clientWidth * scale), h = Math.round(w * ratio);
    if (!w) return;
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const per = across * down, image = sheet(Math.floor(slot / per));
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = "#8b9096";
    context.fillRect(0, 0, w, h);
    if (image?.complete && image.naturalWidth) {
      const cell = image.naturalWidth / across, tall = cell * ratio, k = slot % per;
      context.drawImage(image, (k % across) * cell, Math.floor(k / across) * tall, cell, tall, 0, 0, w, h);
    }
    sheet((Math.floor(slot / per) + 1) % sheets.length);
    const line = Math.max(1.5, w / 420);
    for (const source of sources) {
      if (!source.on || !source.packed) continue;
      context.save();
      context.scale(w, h);
      const [reference, moving] = paths(source, slot);
      context.fillStyle = source.colour;
      context.globalAlpha = 0.4 * strength;
      context.fill(reference, "evenodd");
      context.globalAlpha = strength * 1.4 > 1 ? 1 : strength * 1.4;
      context.fill(moving, "evenodd");
      context.restore();
      context.save();
      context.lineJoin = "round";
      for (const [path, dashed] of [[reference, true], [moving, false]]) {
        const scaled = new Path2D();
        scaled.addPath(path, new DOMMatrix([w, 0, 0, h, 0, 0]));
        context.setLineDash(dashed ? [3 * line, 2 * line] : []);
        context.strokeStyle = "#ffffffb0";
        context.lineWidth = 2 * line;
        if (!dashed) context.stroke(scaled);
        context.strokeStyle = source.colour;
        context.lineWidth = line;
        context.stroke(scaled);
      }
      context.restore();
    }
    if (axes)
      for (const source of sources) {
        const poses = data.axes.poses[source.id] ?? data.poses;
        if (!source.on || !source.axis || !poses) continue;
        const [a, b] = axisEnds(source.axis, poses);
        if (!a || !b) continue;
        const s = w / width, [x0, y0, x1, y1] = [a[0] * s, a[1] * s, b[0] * s, b[1] * s];
        const length = Math.hypot(x1 - x0, y1 - y0), head = Math.min(7 * line, length / 3);
        if (length < 2) continue;
        const [u, v] = [(x1 - x0) / length, (y1 - y0) / length], arrow = new Path2D();
        arrow.moveTo(x0, y0);
        arrow.lineTo(x1, y1);
        arrow.moveTo(x1 - head * (u - 0.5 * v), y1 - head * (v + 0.5 * u));
        arrow.lineTo(x1, y1);
        arrow.lineTo(x1 - head * (u + 0.5 * v), y1 - head * (v - 0.5 * u));
        context.lineCap = context.lineJoin = "round";
        for (const [style, thick] of [["#ffffffd0", 3.6 * line], [source.colour, 1.8 * line]]) {
          context.strokeStyle = style;
          context.lineWidth = thick;
          context.stroke(arrow);
        }
      }
  };
  let waiting = false;
  const redraw = () => {
    if (!waiting) requestAnimationFrame(() => { waiting = false; draw(); });
    waiting = true;
  };

  /* Controls. */
  const scrub = element("input", { type: "range", min: 0, max: n - 1, step: 1, value: 0, "aria-label": "frame" });
  const readout = element("output", { class: "readout" });
  const show = (next) => bus.show(frames[clamp(next, 0, n - 1)]);
  bus.on("frame", (frame) => {
    let best = 0;
    for (let i = 1; i < n; i++) if (Math.abs(frames[i] - frame) < Math.abs(frames[best] - frame)) best = i;
    slot = best;
    scrub.value = slot;
    readout.textContent = `frame ${frames[slot]} · ${times[slot].toFixed(2)} s`;
    redraw();
  });
  let start = null;
  const tick = (now) => {
    if (!play.playing) return;
    start ??= now - (times[slot] - times[0]) * 1000;
    let time = times[0] + (now - start) / 1000;
    if (time > times[n - 1] + 0.4) {
      start = now;
      time = times[0];
    }
    let next = 0;
    while (next < n - 1 && times[next + 1] <= time) next++;
    if (next !== slot) show(next);
    requestAnimationFrame(tick);
  };
  const play = FreeArt.playButton("play the video", (playing) => {
    start = null;
    if (playing) requestAnimationFrame(tick);
  });
  const step = (next) => {
    play.set(false);
    show(next);
  };
  scrub.addEventListener("input", () => step(Number(scrub.value)));
  canvas.addEventListener("click", () => play.click());
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const moves = { ArrowLeft: slot - 1, ArrowRight: slot + 1, Home: 0, End: n - 1 };
    if (event.key === " ") play.click();
    else if (event.key in moves) step(moves[event.key]);
    else return;
    event.preventDefault();
  });
  const chips = element("div", { class: "sources", role: "group", "aria-label": "whose parts are shown" });
  for (const source of sources) {
    const button = element("button", { type: "button", class: "chip", "aria-pressed": source.on, disabled: !source.packed && !source.axis });
    button.append(FreeArt.mark(source), element("span", { class: "who" }, source.name), ...(source.packed ? [] : [element("small", {}, source.why || "no masks")]));
    button.addEventListener("click", () => {
      source.on = !source.on;
      button.setAttribute("aria-pressed", source.on);
      redraw();
    });
    chips.append(button);
  }
  const opacity = element("input", { type: "range", min: 0, max: 70, value: 35, "aria-label": "how strong the colours are" });
  opacity.addEventListener("input", () => {
    strength = Number(opacity.value) / 100;
    redraw();
  });
  const axisBox = element("input", { type: "checkbox", checked: true });
  axisBox.addEventListener("change", () => {
    axes = axisBox.checked;
    redraw();
  });
  section.querySelector(".stage").replaceChildren(canvas);
  section.querySelector(".player").append(
    element("div", { class: "transport" }, play, scrub, readout), chips,
    element("div", { class: "controls" }, element("label", { class: "strength" }, element("span", { class: "label" }, "Colour"), opacity),
      element("label", {}, axisBox, "Joint axes")));
  new ResizeObserver(redraw).observe(canvas);
  show(0);
};

/** The mark of a source: its shape in its colour. */
FreeArt.mark = ({ shape, colour }) => {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("class", "mark");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", shape);
  path.setAttribute("fill", colour);
  svg.append(path);
  return svg;
};
