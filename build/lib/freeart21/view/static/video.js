/* The video player. */

FreeArt.kinds.video = (section, data, bus) => {
  const { element } = FreeArt;
  const n = data.frames.length;
  const times = data.times_s ?? data.frames.map((frame) => frame / 30);
  const images = { rgb: data.rgb, depth: data.depth, labels: data.labels };
  const loaded = { rgb: [], depth: [], labels: [] };
  const anyParts = data.found || data.truth;
  let slot = 0, picture = data.rgb ? "rgb" : "none", speed = 1;
  const axes = data.axes ?? [];
  let opacity = 0.4, axisShown = axes.length > 0, doubtShown = false;
  let parts = data.found ? "found" : data.truth ? "truth" : "off";

  const panes = ["found", "truth"].map((name) => {
    const canvas = element("canvas", { width: data.width, height: data.height });
    const pane = element("figure", {}, canvas, element("figcaption", {}, name === "found" ? "found" : "truth"));
    return { name, canvas, pane, context: canvas.getContext("2d") };
  });
  const scratch = element("canvas", { width: data.width, height: data.height });
  const scratchContext = scratch.getContext("2d", { willReadFrequently: true });

  const image = (kind, i) => {
    if (!loaded[kind][i]) {
      const picture = new Image();
      picture.src = images[kind][i];
      loaded[kind][i] = picture;
    }
    return loaded[kind][i];
  };

  /* Colours over one pane: the foreground in white, or the parts with their outlines. */
  const rgbOf = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  const palette = data.colours.map(rgbOf), unsure = rgbOf("#e4002b");
  const paint = (context, channel, style) => {
    const { width, height } = data;
    scratchContext.drawImage(image("labels", slot), 0, 0);
    const pixels = scratchContext.getImageData(0, 0, width, height);
    const bytes = pixels.data;
    const label = new Uint8Array(width * height);
    const doubtful = doubtShown && channel === 1;
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
    scratchContext.putImageData(pixels, 0, 0);
    context.drawImage(scratch, 0, 0);
    scratchContext.clearRect(0, 0, width, height);
  };

  /* A joint axis over one pane: an arrow with a light rim, its head at the positive end. */
  const paintAxis = (context, { colour, ends }) => {
    if (!ends[slot]) return;
    const [u0, v0, u1, v1] = ends[slot];
    const length = Math.hypot(u1 - u0, v1 - v0);
    if (length < 1e-3) return;
    const thick = Math.max(2, data.width / 210), head = Math.min(5 * thick, length / 3);
    const [a, b] = [(u1 - u0) / length, (v1 - v0) / length];
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

  let wanted = 0;
  const draw = async () => {
    const ticket = ++wanted;
    const needed = [];
    if (picture === "rgb" || picture === "depth") needed.push(image(picture, slot));
    if (parts !== "off" || picture === "foreground") needed.push(image("labels", slot));
    await Promise.all(needed.map((one) => one.complete || one.decode()));
    if (ticket !== wanted) return;
    for (const { name, context, pane } of panes) {
      const shown = parts === "beside" || name === (parts === "truth" ? "truth" : "found");
      pane.hidden = !shown;
      if (!shown) continue;
      context.fillStyle = picture === "foreground" ? "#14181c" : "#e9edf0";
      context.fillRect(0, 0, data.width, data.height);
      if (picture === "rgb" || picture === "depth") context.drawImage(image(picture, slot), 0, 0);
      if (picture === "foreground") paint(context, 0, "foreground");
      if (parts !== "off") paint(context, name === "truth" ? 2 : 1, data.rgb ? "clear" : "solid");
      for (const axis of axisShown ? axes : []) if (axis.name === "truth" || name === "found") paintAxis(context, axis);
    }
    for (let ahead = 1; ahead < 4; ahead++)
      for (const kind of [picture, "labels"])
        if (images[kind]) image(kind, (slot + ahead) % n);
  };

  /* Controls. */
  const scrub = element("input", { type: "range", min: 0, max: n - 1, step: 1, value: 0, "aria-label": "frame" });
  const readout = element("output", { class: "readout" });
  const show = (next) => {
    slot = FreeArt.clamp(next, 0, n - 1);
    bus.show(data.frames[slot]);
  };
  const update = (frame) => {
    let best = 0;
    for (let i = 1; i < n; i++) if (Math.abs(data.frames[i] - frame) < Math.abs(data.frames[best] - frame)) best = i;
    slot = best;
    scrub.value = slot;
    const state = data.states ? ` · ${FreeArt.stateText(data.joint_type, data.states[slot])}` : "";
    readout.textContent = `frame ${data.frames[slot]}${data.times_s ? ` · ${times[slot].toFixed(2)} s` : ""}${state}`;
    draw();
  };
  let start = null;
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
  const pause = () => play.set(false);
  scrub.addEventListener("input", () => {
    pause();
    show(Number(scrub.value));
  });
  const rate = FreeArt.choice("speed", [["0.25", "¼×"], ["0.5", "½×"], ["1", "1×"], ["2", "2×"]], "1", (value) => {
    speed = Number(value);
    start = null;
  });

  const pictures = data.rgb ? [["rgb", "RGB"], ["depth", "Depth"], ["foreground", "Foreground"]] : [["none", "Plain"]];
  const legendParts = element("ul", { class: "legend" },
    ...["reference part", "moving part"].map((name, k) =>
      element("li", {}, element("i", { "data-colour": data.colours[k] }), name)));
  for (const { name, colour } of axes)
    legendParts.append(element("li", {}, element("i", { class: "line", "data-colour": colour }), `${name === "truth" ? "true" : "joint"} axis`));
  const legendDoubt = element("li", { title: "red: even odds or worse; no red: sure" },
    element("i", { "data-colour": "#e4002b" }), "unsure label");
  legendParts.append(legendDoubt);
  for (const mark of legendParts.querySelectorAll("i")) mark.style.background = mark.dataset.colour;
  const bar = element("span", { class: "bar" });
  if (data.depth_colours) bar.style.background = `linear-gradient(to right, ${data.depth_colours.join(",")})`;
  const legendDepth = element("p", { class: "legend" }, `${data.depth_range_m[0].toFixed(2)} m`, bar,
    `${data.depth_range_m[1].toFixed(2)} m`);
  const legends = () => {
    legendParts.hidden = strengthBox.hidden = parts === "off";
    legendDoubt.hidden = !doubtShown;
    legendDepth.hidden = picture !== "depth";
  };
  const pictureChoice = FreeArt.choice("picture", pictures, picture, (value) => {
    picture = value;
    legends();
    draw();
  });
  const partsOptions = [["off", "Off"], ["found", "Found"], ["truth", "Truth"], ["beside", "Side by side"]]
    .filter(([value]) => value === "off" || (value === "beside" ? data.found && data.truth : data[value]));
  const partsChoice = FreeArt.choice("parts", partsOptions, parts, (value) => {
    parts = value;
    stage.classList.toggle("beside", parts === "beside");
    legends();
    draw();
  });
  const strength = element("input", { type: "range", min: 0, max: 100, value: 100 * opacity, "aria-label": "opacity of the parts" });
  strength.addEventListener("input", () => {
    opacity = Number(strength.value) / 100;
    draw();
  });
  const axisBox = element("input", { type: "checkbox", checked: true });
  axisBox.addEventListener("change", () => {
    axisShown = axisBox.checked;
    draw();
  });
  const doubtBox = element("input", { type: "checkbox" });
  const showDoubt = (shown) => {
    doubtBox.checked = doubtShown = shown;
    legends();
    draw();
  };
  doubtBox.addEventListener("change", () => showDoubt(doubtBox.checked));
  const strengthBox = element("label", { class: "strength" }, element("span", { class: "label" }, "Opacity"), strength);
  const named = (name, choice) => element("div", {}, element("span", { class: "label" }, name), choice);
  const stage = element("div", { class: "stage" }, ...panes.map(({ pane }) => pane));
  section.querySelector(".player").append(
    stage,
    element("div", { class: "transport" }, play, scrub, readout),
    element("div", { class: "controls" },
      ...(pictures.length > 1 ? [named("Picture", pictureChoice)] : []),
      ...(anyParts ? [named("Parts", partsChoice), strengthBox] : []),
      ...(data.confidence ? [element("label", {}, doubtBox, "Doubt")] : []),
      ...(axes.length ? [element("label", {}, axisBox, "Axis")] : []),
      named("Speed", rate)),
    legendParts, legendDepth);
  legends();

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches?.("input[type=range]") && event.target !== scrub) return;
    if (event.key === " " && event.target.closest?.("button, input[type=checkbox]")) return;
    const moves = { ArrowLeft: slot - 1, ArrowRight: slot + 1, Home: 0, End: n - 1 };
    if (event.key === " ") play.click();
    else if (event.key in moves) {
      pause();
      show(moves[event.key]);
    } else return;
    event.preventDefault();
  });
  bus.on("frame", update);
  bus.on("link", (link) => {
    if (link.doubt && data.confidence) showDoubt(link.doubt !== "off");
    if (link.axis) {
      axisBox.checked = axisShown = link.axis !== "off" && axes.length > 0;
      draw();
    }
    if (link.picture) pictureChoice.set(link.picture);
    if (link.parts) partsChoice.set(link.parts);
  });
  update(0);
};
