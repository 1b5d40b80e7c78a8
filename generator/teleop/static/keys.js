// Keyboard: held keys move the object in real time, others are commands.

const TURN = Math.PI / 2; // radians a second
const SHIFT = 0.6; // heights of the picture a second
const DEPTH = 0.7; // e-folds of the depth a second
const SWING = 0.5; // ranges of the joint a second
const SLOW = 0.25; // with the shift key

const HELD = {
  ArrowLeft: { turn: [0, 1, 0] }, ArrowRight: { turn: [0, -1, 0] },
  ArrowUp: { turn: [-1, 0, 0] }, ArrowDown: { turn: [1, 0, 0] },
  Comma: { turn: [0, 0, -1] }, Period: { turn: [0, 0, 1] },
  KeyA: { shift: [-1, 0] }, KeyD: { shift: [1, 0] }, KeyW: { shift: [0, -1] }, KeyS: { shift: [0, 1] },
  KeyQ: { depth: 1 }, KeyE: { depth: -1 }, BracketLeft: { swing: -1 }, BracketRight: { swing: 1 },
};
const COMMANDS = { KeyR: "record", KeyP: "pause", KeyU: "undo", Enter: "save" };

export function startKeys({ hand, link, may }) {
  const held = new Set();
  let slow = false, last = null;

  /** Whether the focused element needs the key itself. */
  function taken(event) {
    const target = event.target;
    if (!(target instanceof HTMLElement)) return false;
    if (target.isContentEditable || target.matches("input:not([type=range]), textarea, select")) return true;
    if (target.matches("input[type=range]")) return event.code.startsWith("Arrow");
    return target.matches("button, a") && (event.code === "Enter" || event.code === "Space");
  }

  function step(now) {
    const dt = last === null ? 0 : Math.min((now - last) / 1000, 0.1);
    last = now;
    if (held.size && dt > 0 && may()) {
      const pace = dt * (slow ? SLOW : 1);
      const sum = { turn: [0, 0, 0], shift: [0, 0], depth: 0, swing: 0 };
      for (const code of held) {
        const does = HELD[code];
        if (does.turn) does.turn.forEach((x, k) => (sum.turn[k] += x));
        if (does.shift) does.shift.forEach((x, k) => (sum.shift[k] += x));
        sum.depth += does.depth || 0;
        sum.swing += does.swing || 0;
      }
      if (sum.turn.some(Boolean)) hand.turn(sum.turn.map((x) => x * TURN * pace), "keys");
      if (sum.shift.some(Boolean)) {
        const way = SHIFT * hand.span() * pace;
        hand.shift([sum.shift[0] * way, sum.shift[1] * way, 0], "keys");
      }
      if (sum.depth) hand.away(Math.exp(sum.depth * DEPTH * pace), "keys");
      if (sum.swing) hand.swing(sum.swing * SWING * pace * (hand.limits[1] - hand.limits[0]), "keys");
    }
    if (held.size) requestAnimationFrame(step);
    else last = null;
  }

  addEventListener("keydown", (event) => {
    slow = event.shiftKey;
    if (taken(event) || event.altKey) return;
    if (event.ctrlKey || event.metaKey) {
      if (event.code === "KeyZ" && !event.repeat) {
        event.preventDefault();
        link.do("undo");
      }
      return;
    }
    if (HELD[event.code]) {
      event.preventDefault();
      if (!held.size) requestAnimationFrame(step);
      held.add(event.code);
    } else if (COMMANDS[event.code] && !event.repeat) {
      event.preventDefault();
      const recording = link.status && link.status.recording, paused = link.status && link.status.paused;
      let command = COMMANDS[event.code];
      if (command === "pause" && paused) command = "record";
      if (command === "record" && recording) command = "pause";
      link.do(command);
    }
  });
  addEventListener("keyup", (event) => {
    slow = event.shiftKey;
    held.delete(event.code);
  });
  addEventListener("blur", () => held.clear());
}
