"use strict";
/* Shared by all scripts: elements, arrays, texts, the current frame of the video and the address's #frame=40&state=0.8 */

const FreeArt = { kinds: {} };

/** An element with attributes ("on..." are listeners) and children; strings become text, never markup. */
FreeArt.element = (tag, attributes = {}, ...children) => {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name.startsWith("aria-")) node.setAttribute(name, value);
    else if (value === true) node.setAttribute(name, "");
    else if (value !== false && value !== null) node.setAttribute(name, value);
  }
  node.append(...children);
  return node;
};

/** The typed array behind the output of `embed_array` or `embed_points`. */
FreeArt.array = (data) => {
  const text = atob(data.base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const kinds = { f32: Float32Array, u32: Uint32Array, u16: Uint16Array, u8: Uint8Array };
  const array = new kinds[data.dtype](bytes.buffer), { low, steps } = data;
  return low ? Float32Array.from(array, (x, i) => low[i % low.length] + steps[i % low.length] * x) : array;
};

/** A joint state, rad or m, in degrees or centimetres. */
FreeArt.stateText = (type, q) => {
  const tenths = Math.round((type === "revolute" ? (q * 180) / Math.PI : q * 100) * 10) / 10 + 0;
  return type === "revolute" ? `${tenths.toFixed(1)}°` : `${tenths.toFixed(1)} cm`;
};

FreeArt.clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** Index of the entry of `values` nearest to `value`. */
FreeArt.nearest = (values, value) => {
  let best = 0;
  for (let i = 1; i < values.length; i++) if (Math.abs(values[i] - value) < Math.abs(values[best] - value)) best = i;
  return best;
};

/** The current frame of the video, with listeners for it and for the address. */
FreeArt.makeBus = () => {
  const listeners = { frame: [], link: [] };
  return {
    frame: 0,
    on(what, listener) { listeners[what].push(listener); },
    show(frame) {
      this.frame = frame;
      for (const listener of listeners.frame) listener(frame);
    },
    follow(link) {
      for (const listener of listeners.link) listener(link);
    },
  };
};

/** Makes a button stay pressed; `set(pressed)` is called after every click. */
FreeArt.toggle = (button, set, pressed = true) => {
  button.setAttribute("aria-pressed", pressed);
  button.addEventListener("click", () => {
    const next = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", next);
    set(next);
  });
  return button;
};

/** A check box with its text; `set(checked)` is called after every change. */
FreeArt.checkBox = (text, checked, set) => {
  const box = FreeArt.element("input", { type: "checkbox", checked, onchange: () => set(box.checked) });
  return FreeArt.element("label", {}, box, text);
};

/** A labelled range from 0 to 100; `set(value)` is called after every change. */
FreeArt.percentage = (name, label, value, set) => {
  const range = FreeArt.element("input", { type: "range", min: 0, max: 100, value, "aria-label": label,
    oninput: () => set(Number(range.value)) });
  return FreeArt.element("label", { class: "strength" }, FreeArt.element("span", { class: "label" }, name), range);
};

const ICONS = {
  play: '<svg viewBox="0 0 16 16" aria-hidden="true"><path d="M4 2.5v11l9.5-5.5z"/></svg>',
  pause: '<svg viewBox="0 0 16 16" aria-hidden="true"><path d="M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z"/></svg>',
};

/** A round play button; `toggle(playing)` is called after every click. */
FreeArt.playButton = (label, toggle) => {
  const button = FreeArt.element("button", { class: "play", type: "button", "aria-label": label, title: label });
  button.set = (playing) => {
    button.playing = playing;
    button.innerHTML = playing ? ICONS.pause : ICONS.play;
    button.setAttribute("aria-pressed", playing);
  };
  button.set(false);
  button.addEventListener("click", () => {
    button.set(!button.playing);
    toggle(button.playing);
  });
  return button;
};

/** One of several choices [[value, text], ...]; `choose(value)` is called after every change. */
FreeArt.choice = (label, options, chosen, choose) => {
  const group = FreeArt.element("div", { class: "choice", role: "group", "aria-label": label });
  const buttons = options.map(([value, text]) =>
    FreeArt.element("button", { type: "button", "data-value": value, onclick: () => group.set(value) }, text));
  const press = (value) => buttons.forEach((button) => button.setAttribute("aria-pressed", button.dataset.value === value));
  group.set = (value) => {
    if (!options.some(([known]) => known === value)) return;
    press(value);
    choose(value);
  };
  group.append(...buttons);
  press(chosen);
  return group;
};
