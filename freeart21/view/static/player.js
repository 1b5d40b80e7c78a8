/* What the players have in common: images, the clock with its controls and keys, arrows along joint axes. */

/** Images at addresses, each a grid of `across` x `down` images of the video (the last one may have fewer rows). */
FreeArt.images = (addresses, across = 1, down = 1) => {
  const loaded = [];
  const load = (i) => {
    const k = Math.floor(i / (across * down));
    if (!loaded[k] && addresses[k]) {
      loaded[k] = new Image();
      loaded[k].src = addresses[k];
    }
    return loaded[k];
  };
  return {
    load,
    /** Waits until image i can be drawn. */
    async ready(i) {
      const image = load(i);
      if (image && !image.complete) await image.decode().catch(() => {});
    },
    /** Image i over a canvas of this size. */
    draw(context, i, width, height) {
      const image = load(i), cell = i % (across * down);
      if (!image?.complete || !image.naturalWidth) return;
      const w = image.naturalWidth / across, h = (w * height) / width;
      context.drawImage(image, (cell % across) * w, Math.floor(cell / across) * h, w, h, 0, 0, width, height);
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
  const show = (next) => {
    slot = FreeArt.clamp(next, 0, n - 1);
    bus.show(frames[slot]);
  };
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
    if (event.target.matches?.("select, input[type=range]") && event.target !== scrub) return;
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
    show,
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
