/* The video player: images, and over them the parts and the joint axis of every source that is switched on. */

/** Images at addresses, loaded when they are needed. */
FreeArt.images = (addresses) => {
  const loaded = [];
  const load = (i) => {
    if (!loaded[i] && addresses[i]) {
      loaded[i] = new Image();
      loaded[i].src = addresses[i];
    }
    return loaded[i];
  };
  return {
    load,
    async ready(i) {
      const image = load(i);
      if (image && !image.complete) await image.decode().catch(() => {});
      return image?.naturalWidth ? image : null;
    },
  };
};

/** The clock over `frames` of the video at `times`, s: play button, slider, readout, speed; space and arrow keys.
 *
 * `draw(slot)` is called after every change with the index in `frames`; `text(slot)` is added to the readout. */
FreeArt.clock = (bus, frames, times, draw, text) => {
  const { element } = FreeArt, n = frames.length;
  let slot = 0, speed = 1, start = null;
  const scrub = element("input", { type: "range", min: 0, max: n - 1, step: 1, value: 0, "aria-label": "frame" });
  const readout = element("output", { class: "readout" });
  const show = (next) => bus.show(frames[FreeArt.clamp(next, 0, n - 1)]);
  const tick = (now) => {
    if (!play.playing) return;
    start ??= now - ((times[slot] - times[0]) * 1000) / speed;
    let time = times[0] + ((now - start) / 1000) * speed;
    if (time > times[n - 1] + 0.4) {
      start = now;
      time = times[0];
    }
    let next = slot >= n - 1 && time < times[n - 1] ? 0 : slot;
    while (next < n - 1 && times[next + 1] <= time) next++;
    if (next !== slot) show(next);
    requestAnimationFrame(tick);
  };
  const play = FreeArt.playButton("play the video (space)", (playing) => {
    start = null;
    if (playing && slot === n - 1) show(0);
    if (playing) requestAnimationFrame(tick);
  });
  const step = (next) => {
    play.set(false);
    show(next);
  };
  scrub.addEventListener("input", () => step(Number(scrub.value)));
  const rate = FreeArt.choice("speed", [["0.25", "¼×"], ["0.5", "½×"], ["1", "1×"], ["2", "2×"]], "1", (value) => {
    speed = Number(value);
    start = null;
  });
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches?.("input[type=range]") && event.target !== scrub) return;
    if (event.key === " " && event.target.closest?.("button, summary, input[type=checkbox]")) return;
    const moves = { ArrowLeft: slot - 1, ArrowRight: slot + 1, Home: 0, End: n - 1 };
    if (event.key === " ") play.click();
    else if (event.key in moves) step(moves[event.key]);
    else return;
    event.preventDefault();
  });
  bus.on("frame", (frame) => {
    slot = FreeArt.nearest(frames, frame);
    scrub.value = slot;
    readout.textContent = `frame ${frames[slot]}${text(slot)}`;
    draw(slot);
  });
  return {
    play,
    row: element("div", { class: "transport" }, play, scrub, readout),
    speed: element("div", {}, element("span", { class: "label" }, "Speed"), rate),
  };
};

/** An arrow from one end [u0, v0, u1, v1] of a joint axis to the other, with a white rim. */
FreeArt.drawArrow = (context, [u0, v0, u1, v1], colour, thick) => {
  const length = Math.hypot(u1 - u0, v1 - v0);
  if (length < 1e-3) return;
  const head = Math.min(5 * thick, length / 3), [a, b] = [(u1 - u0) / length, (v1 - v0) / length];
  const line = new Path2D();
  line.moveTo(u0, v0);
  line.lineTo(u1, v1);
  line.moveTo(u1 - head * (a - 0.5 * b), v1 - head * (b + 0.5 * a));
  line.lineTo(u1, v1);
  line.lineTo(u1 - head * (a + 0.5 * b), v1 - head * (b - 0.5 * a));
  context.lineCap = context.lineJoin = "round";
  for (const [style, width] of [["#ffffffd0", 2.2 * thick], [colour, thick]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.stroke(line);
  }
};

/** A function that turns an image of labels into one of both parts with their outlines, on a canvas of its own. */
FreeArt.labelPainter = ([width, height]) => {
  const context = FreeArt.element("canvas", { width, height }).getContext("2d", { willReadFrequently: true });
  const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)), unsure = [228, 0, 43];
  return (image, colours, opacity, doubted) => {
    context.clearRect(0, 0, width, height);
    context.drawImage(image, 0, 0, width, height);
    const pixels = context.getImageData(0, 0, width, height), bytes = pixels.data, palette = colours.map(rgb);
    const label = new Uint8Array(width * height), edge = Math.max(1, Math.round(width / 400));
    for (let i = 0; i < label.length; i++) label[i] = Math.floor(bytes[4 * i] / 100 + 0.1);
    for (let i = 0, y = 0; y < height; y++)
      for (let x = 0; x < width; x++, i++) {
        const value = label[i];
        const doubt = doubted && value ? FreeArt.clamp(2 - (bytes[4 * i] - 100 * value) / 20, 0, 1) : 0;
        bytes[4 * i + 3] = 0;
        if (!value) continue;
        const rim = x < edge || x >= width - edge || y < edge || y >= height - edge || label[i - edge] !== value
          || label[i + edge] !== value || label[i - edge * width] !== value || label[i + edge * width] !== value;
        const dashed = value === 1 && (x + y) % (8 * edge) < 4 * edge;
        for (let c = 0; c < 3; c++) bytes[4 * i + c] = (1 - doubt) * palette[value - 1][c] + doubt * unsure[c];
        const alpha = (value === 1 ? 0.6 : 1) * opacity;
        bytes[4 * i + 3] = 255 * (rim && !dashed ? 1 : alpha + doubt * Math.max(0, 0.85 - alpha));
      }
    context.putImageData(pixels, 0, 0);
    return context.canvas;
  };
};

FreeArt.kinds.video = (section, data, bus) => {
  const { element } = FreeArt, { width, height } = data;
  const times = data.times_s ?? data.frames.map((frame) => frame / 30), paint = FreeArt.labelPainter(data.label_size);
  const pictures = { rgb: FreeArt.images(data.rgb ?? []), depth: FreeArt.images(data.depth ?? []) };
  const sources = data.sources.map((source) => ({ ...source, images: FreeArt.images(source.labels ?? []) }));
  let slot = 0, picture = data.rgb ? "rgb" : "none", opacity = data.rgb ? 0.4 : 0.85, axisShown = true, doubtShown = false;
  const canvas = element("canvas", { width, height, tabindex: 0, role: "application",
    "aria-label": "video with the parts over it; space plays, left and right arrows step" });
  const context = canvas.getContext("2d");

  let wanted = 0;
  const draw = async () => {
    const ticket = ++wanted, shown = sources.filter(({ on }) => on);
    const [image, ...labels] = await Promise.all([pictures[picture]?.ready(slot), ...shown.map(({ images }) => images.ready(slot))]);
    if (ticket !== wanted) return;
    context.fillStyle = "#e9edf0";
    context.fillRect(0, 0, width, height);
    if (image) context.drawImage(image, 0, 0, width, height);
    shown.forEach((source, k) => {
      if (labels[k]) context.drawImage(paint(labels[k], source.colours, opacity, doubtShown && source.confidence), 0, 0, width, height);
    });
    for (const { axis, axis_colour } of axisShown ? shown : [])
      if (axis?.[slot]) FreeArt.drawArrow(context, axis[slot], axis_colour, Math.max(2, width / 210));
    for (let ahead = 1; ahead < 4; ahead++)
      for (const images of [pictures[picture], ...shown.map((source) => source.images)]) images?.load((slot + ahead) % data.frames.length);
  };
  const clock = FreeArt.clock(bus, data.frames, times, (now) => {
    slot = now;
    draw();
  }, (i) => (data.times_s ? ` · ${times[i].toFixed(2)} s` : "") + (data.states ? ` · ${FreeArt.stateText(data.joint_type, data.states[i])}` : ""));
  canvas.addEventListener("click", () => clock.play.click());

  const chips = element("div", { class: "sources", role: "group", "aria-label": "whose parts are shown" });
  for (const source of sources) {
    source.on = source.shown && Boolean(source.labels || source.axis);
    const marks = source.colours.map((colour) => {
      const mark = element("i", {});
      mark.style.background = colour;
      return mark;
    });
    const button = element("button", { class: "chip", type: "button", disabled: !source.labels && !source.axis },
      ...marks, source.name, ...(source.absent ? [element("small", {}, source.absent)] : []));
    chips.append(FreeArt.toggle(button, (on) => {
      source.on = on;
      draw();
    }, source.on));
  }
  const named = (name, choice) => element("div", {}, element("span", { class: "label" }, name), choice);
  const [near, far] = data.depth_range_m.map((metres) => `${metres.toFixed(2)} m`);
  const depthLegend = element("p", { class: "note", hidden: true }, `Depth from ${near} (light) to ${far} (dark); grey: not measured.`);
  const pictureChoice = FreeArt.choice("image", [["rgb", "Colour"], ["depth", "Depth"], ["none", "None"]], picture, (value) => {
    picture = value;
    depthLegend.hidden = value !== "depth";
    draw();
  });
  const strength = FreeArt.percentage("Opacity", "opacity of the parts", 100 * opacity, (value) => {
    opacity = value / 100;
    draw();
  });
  const axis = FreeArt.checkBox("Joint axes", axisShown, (on) => {
    axisShown = on;
    draw();
  });
  const doubt = FreeArt.checkBox("Label uncertainty (red)", false, (on) => {
    doubtShown = on;
    draw();
  });
  section.querySelector("h2").after(element("div", { class: "stage" }, canvas), clock.row, chips,
    element("div", { class: "controls" },
      ...(data.depth ? [named("Image", pictureChoice)] : []),
      ...(sources.length ? [strength] : []),
      ...(sources.some(({ confidence }) => confidence) ? [doubt] : []),
      ...(sources.some((source) => source.axis) ? [axis] : []),
      clock.speed), depthLegend);
  bus.on("link", (link) => {
    if (link.picture) pictureChoice.set(link.picture);
    if (link.doubt) doubt.querySelector("input").checked = doubtShown = link.doubt !== "off";
    draw();
  });
  bus.show(0);
};
