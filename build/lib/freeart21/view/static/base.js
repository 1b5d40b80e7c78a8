"use strict";
/* What all parts of the page share: elements, arrays, the clock of the video, deep links such as #frame=40&state=0.8 */

const FreeArt = { kinds: {} };

/** An element with attributes ("on..." are listeners) and children; texts become text, never markup. */
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

/** The typed array that `embed_array` or `embed_points` put into the page, or one that is ready. */
FreeArt.array = (data) => {
  if (ArrayBuffer.isView(data)) return data;
  const text = atob(data.base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const kinds = { f32: Float32Array, u32: Uint32Array, u16: Uint16Array, u8: Uint8Array };
  const array = new kinds[data.dtype](bytes.buffer), { low, steps } = data;
  return low ? Float32Array.from(array, (x, i) => low[i % low.length] + steps[i % low.length] * x) : array;
};

/** A joint state, rad or m, as people read it. */
FreeArt.stateText = (type, q) => {
  const tenths = Math.round((type === "revolute" ? (q * 180) / Math.PI : q * 100) * 10) / 10 + 0;
  return type === "revolute" ? `${tenths.toFixed(1)}°` : `${tenths.toFixed(1)} cm`;
};

FreeArt.clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** The current frame of the video, and who wants to know of it. */
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

const ICONS = {
  play: '<svg viewBox="0 0 16 16" aria-hidden="true"><path d="M4 2.5v11l9.5-5.5z"/></svg>',
  pause: '<svg viewBox="0 0 16 16" aria-hidden="true"><path d="M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z"/></svg>',
};

/** A round play button; `toggle(playing)` hears of every press. */
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

/** One of several choices [[value, text], ...]; `choose(value)` hears of every change. */
FreeArt.choice = (label, options, chosen, choose) => {
  const group = FreeArt.element("div", { class: "choice", role: "group", "aria-label": label });
  const buttons = options.map(([value, text]) =>
    FreeArt.element("button", { type: "button", "data-value": value, onclick: () => group.set(value) }, text));
  group.set = (value) => {
    if (!options.some(([known]) => known === value)) return;
    for (const button of buttons) button.setAttribute("aria-pressed", button.dataset.value === value);
    choose(value);
  };
  group.append(...buttons);
  for (const button of buttons) button.setAttribute("aria-pressed", button.dataset.value === chosen);
  return group;
};
