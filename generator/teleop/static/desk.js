// Mouse and touch: drag turns, shift-drag or right-drag moves, the wheel is the joint; two fingers move, pinch and twist.

import { startKeys } from "./keys.js";

const WHEEL_RANGE = 1200; // pixels of the wheel that take the joint through its range: twelve notches
const WHEEL_DEPTH = 0.0012; // of a pixel of the wheel, as a share of the depth: a notch is 12 %
const LINE_PX = 33; // of a wheel that counts in lines: three lines are a notch

/** The point under (x, y) on the sphere around the object, in its radii; outside it on a hyperbola (Bell's trackball). */
function onBall(x, y) {
  const d2 = x * x + y * y;
  return [x, y, -(d2 < 0.5 ? Math.sqrt(1 - d2) : 0.5 / Math.sqrt(d2))];
}

/** The rotation vector that takes the sphere's point under one position to that under another. */
export function arcball(from, to) {
  const a = onBall(...from), b = onBall(...to);
  const cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const sine = Math.hypot(...cross), cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  if (sine < 1e-12) return [0, 0, 0];
  const angle = Math.atan2(sine, cosine);
  return cross.map((x) => (x / sine) * angle);
}

export class Desk {
  constructor({ hand, link, canvas, may }) {
    Object.assign(this, { hand, link, canvas, may });
    this._pointers = new Map();
    const on = (type, f) => canvas.addEventListener(type, f, { passive: false });
    on("pointerdown", (event) => this._down(event));
    on("pointermove", (event) => this._move(event));
    for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) on(type, (event) => this._up(event));
    on("wheel", (event) => this._wheel(event));
    on("contextmenu", (event) => event.preventDefault());
    startKeys({ hand, link, may });
  }

  /** The picture's rectangle in the page, CSS pixels: it is scaled to fit the canvas. */
  frame() {
    const box = this.canvas.getBoundingClientRect();
    const aspect = this.hand.aspect;
    const height = Math.min(box.height, box.width / aspect), width = height * aspect;
    return { left: box.left + (box.width - width) / 2, top: box.top + (box.height - height) / 2, width, height };
  }

  /** A position of the page relative to the sphere around the object, in its radii. */
  _ball(x, y) {
    const frame = this.frame(), middle = this.hand.middle();
    const scale = frame.height / 2 / Math.tan(this.hand.fovY / 2);
    const cx = frame.left + frame.width / 2 + (scale * middle[0]) / middle[2];
    const cy = frame.top + frame.height / 2 + (scale * middle[1]) / middle[2];
    const radius = 0.42 * Math.min(frame.width, frame.height);
    return [(x - cx) / radius, (y - cy) / radius];
  }

  /** Metres per pixel of the page at the object's depth. */
  _metre() {
    return this.hand.span() / this.frame().height;
  }

  _down(event) {
    event.preventDefault();
    if (document.activeElement && document.activeElement !== document.body) document.activeElement.blur();
    this.canvas.setPointerCapture(event.pointerId);
    const touch = event.pointerType === "touch";
    const moves = !touch && (event.button !== 0 || event.shiftKey);
    this._pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, touch, moves });
    this.canvas.classList.add("held");
  }

  _move(event) {
    const pointer = this._pointers.get(event.pointerId);
    if (!pointer) return;
    const from = [pointer.x, pointer.y], to = [event.clientX, event.clientY];
    const two = this._pointers.size === 2 && pointer.touch;
    const other = two ? [...this._pointers.values()].find((p) => p !== pointer) : null;
    [pointer.x, pointer.y] = to;
    if (!this.may()) return;
    const device = pointer.touch ? "touch" : "mouse";
    if (other) this._twoFingers(from, to, [other.x, other.y]);
    else if (this._pointers.size > 2) return;
    else if (pointer.moves || (!pointer.touch && event.shiftKey)) {
      const metre = this._metre();
      this.hand.shift([(to[0] - from[0]) * metre, (to[1] - from[1]) * metre, 0], device);
    } else this.hand.turn(arcball(this._ball(...from), this._ball(...to)), device);
  }

  _twoFingers(from, to, other) {
    const before = [from[0] - other[0], from[1] - other[1]], after = [to[0] - other[0], to[1] - other[1]];
    const metre = this._metre();
    this.hand.shift([((to[0] - from[0]) / 2) * metre, ((to[1] - from[1]) / 2) * metre, 0], "touch");
    const lengths = [Math.hypot(...before), Math.hypot(...after)];
    if (Math.min(...lengths) < 8) return;
    this.hand.away(lengths[0] / lengths[1], "touch");
    const turned = Math.atan2(before[0] * after[1] - before[1] * after[0], before[0] * after[0] + before[1] * after[1]);
    this.hand.turn([0, 0, turned], "touch");
  }

  _up(event) {
    this._pointers.delete(event.pointerId);
    if (!this._pointers.size) this.canvas.classList.remove("held");
  }

  _wheel(event) {
    event.preventDefault();
    if (!this.may()) return;
    const raw = event.deltaY || event.deltaX; // shift turns a wheel sideways
    const pixels = event.deltaMode === 0 ? raw : event.deltaMode === 1 ? raw * LINE_PX : raw * 400;
    const [low, high] = this.hand.limits;
    if (event.ctrlKey || event.altKey || event.metaKey) this.hand.away(Math.exp(pixels * WHEEL_DEPTH), "mouse");
    else this.hand.swing((-pixels / WHEEL_RANGE) * (high - low), "mouse");
  }
}
