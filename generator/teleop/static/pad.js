// A gamepad of the standard layout: left stick moves, right stick turns, triggers the joint, shoulders the depth.

const TURN = 2.0, SHIFT = 0.7, DEPTH = 0.8, SWING = 0.6; // a second, as for keys
const DEAD = 0.12; // of a stick: worn ones rest that far off
const RECORD = 0, UNDO = 1, SAVE = 3; // A, B, Y
const [LEFT_SHOULDER, RIGHT_SHOULDER, LEFT_TRIGGER, RIGHT_TRIGGER] = [4, 5, 6, 7];

/** A stick's deflection beyond the dead zone, with fine control near the middle. */
function shaped(x) {
  const size = Math.abs(x);
  return size < DEAD ? 0 : Math.sign(x) * ((size - DEAD) / (1 - DEAD)) ** 2;
}

export function startPad({ hand, link, may }) {
  let last = null;
  const pressed = new Map();

  function runCommands(pad) {
    for (const [button, command] of [[RECORD, "record"], [UNDO, "undo"], [SAVE, "save"]]) {
      const down = Boolean(pad.buttons[button] && pad.buttons[button].pressed);
      if (down && !pressed.get(button)) {
        link.do(command === "record" && link.status && link.status.recording ? "pause" : command);
      }
      pressed.set(button, down);
    }
  }

  function step(now) {
    requestAnimationFrame(step);
    const pad = [...navigator.getGamepads()].find((p) => p && p.connected);
    const dt = last === null ? 0 : Math.min((now - last) / 1000, 0.1);
    last = now;
    if (!pad || !may()) return;
    runCommands(pad);
    const [mx, my, tx, ty] = [0, 1, 2, 3].map((k) => shaped(pad.axes[k] || 0));
    const value = (k) => (pad.buttons[k] ? pad.buttons[k].value : 0);
    const swing = value(RIGHT_TRIGGER) - value(LEFT_TRIGGER);
    const depth = value(LEFT_SHOULDER) - value(RIGHT_SHOULDER);
    if (tx || ty) hand.turn([ty * TURN * dt, -tx * TURN * dt, 0], "gamepad");
    if (mx || my) {
      const way = SHIFT * hand.span() * dt;
      hand.shift([mx * way, my * way, 0], "gamepad");
    }
    if (depth) hand.away(Math.exp(depth * DEPTH * dt), "gamepad");
    if (Math.abs(swing) > 0.02) hand.swing(swing * SWING * dt * (hand.limits[1] - hand.limits[0]), "gamepad");
  }
  requestAnimationFrame(step);
}
