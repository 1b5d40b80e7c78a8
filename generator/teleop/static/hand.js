// The commanded pose and joint state: geometry only, no page. Camera axes: x right, y down, z forward; metres, radians.
// Quaternions are [w, x, y, z].

export const multiply = (a, b) => [
  a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
  a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
  a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
  a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
];

export const conjugate = (q) => [q[0], -q[1], -q[2], -q[3]];

export function normalised(q) {
  const length = Math.hypot(...q);
  return q.map((x) => x / length);
}

/** The rotation of the rotation vector `w`. */
export function fromRotationVector(w) {
  const angle = Math.hypot(...w);
  const share = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
  return [Math.cos(angle / 2), w[0] * share, w[1] * share, w[2] * share];
}

export function rotate(q, v) {
  const [w, x, y, z] = q;
  const tx = 2 * (y * v[2] - z * v[1]), ty = 2 * (z * v[0] - x * v[2]), tz = 2 * (x * v[1] - y * v[0]);
  return [v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx];
}

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/** Strip along the picture's border that the object never enters, as a share of its height: as the recorder's MARGIN. */
const MARGIN = 0.02;

/**
 * The commanded pose. All devices change it by `set`, `turn`, `shift` and `swing`. It is limited so that the object stays
 * in the picture and within reach, and its joint within its limits: a take can always be recorded.
 *
 * `placed` increases whenever the server places the object (undo, continue, reset): a device that moves it relative to a
 * grasp must then start a new grasp.
 */
export class Hand {
  constructor() {
    this.position = [0, 0, 1];
    this.quaternion = [1, 0, 0, 0];
    this.state = 0;
    this.limits = [0, 0];
    this.epoch = 0;
    this.placed = 0;
    this.device = "mouse";
    this.centre = [0, 0, 0];
    this.depths = [0.1, 10];
    this.points = [[], []]; // that bound the still and the moving part at joint state zero
    this.joint = { axis: [0, 0, 1], pivot: [0, 0, 0], turns: true };
    this.fovY = 0.7;
    this.aspect = 16 / 9;
    this.onchange = () => {};
  }

  /** Take the object's facts from the server's `hello`. */
  meet(hello) {
    this.limits = hello.limits;
    this.centre = hello.centre;
    this.depths = hello.depths;
    this.points = hello.points;
    this.joint = { axis: hello.axis, pivot: hello.pivot, turns: hello.joint_type === "revolute" };
    this.fovY = hello.fov_y;
    this.aspect = hello.width / hello.height;
    this.place(hello, hello.epoch);
  }

  /** Take a placement of the server; nothing is sent. */
  place(where, epoch) {
    this.position = [...where.position];
    this.quaternion = [...where.quaternion];
    this.state = where.state;
    this.epoch = epoch;
    this.placed += 1;
  }

  /** Set pose and joint state, limited to the allowed region; `time`, ms, of a device with its own clock. */
  set(position, quaternion, state, device, time = null) {
    const q = normalised(quaternion);
    const wanted = add(position, rotate(q, this.centre));
    if (![...q, ...wanted, state].every(Number.isFinite)) return;
    this.state = clamp(state, this.limits[0], this.limits[1]);
    this.position = minus(this._fitted(q, wanted), rotate(q, this.centre));
    this.quaternion = q;
    this.device = device;
    this.onchange(device, time);
  }

  /** The object's centre in the camera's axes. */
  middle() {
    return add(this.position, rotate(this.quaternion, this.centre));
  }

  /** Height of the picture at the object's depth, metres. */
  span() {
    return 2 * Math.tan(this.fovY / 2) * this.middle()[2];
  }

  /** Rotate about the object's centre by a rotation vector in the camera's axes. */
  turn(w, device) {
    const q = normalised(multiply(fromRotationVector(w), this.quaternion));
    this.set(minus(this.middle(), rotate(q, this.centre)), q, this.state, device);
  }

  /** Shift by `d` in the camera's axes. */
  shift(d, device) {
    this.set(add(this.position, d), this.quaternion, this.state, device);
  }

  /** Scale the distance of the object's centre by `factor`, along the line of sight. */
  away(factor, device) {
    const middle = this.middle();
    this.shift(middle.map((x) => x * (factor - 1)), device);
  }

  /** Move the joint by `d`. */
  swing(d, device) {
    this.set(this.position, this.quaternion, this.state + d, device);
  }

  /** Bounding points of the object at the present joint state. */
  bounding() {
    const { axis, pivot, turns } = this.joint;
    const scaled = axis.map((x) => x * this.state);
    const turn = fromRotationVector(scaled);
    const moved = (p) => (turns ? add(rotate(turn, minus(p, pivot)), pivot) : add(p, scaled));
    return [...this.points[0], ...this.points[1].map(moved)];
  }

  /** The allowed centre nearest to `wanted` for the rotation `q`. */
  _fitted(q, wanted) {
    const points = this.bounding().map((p) => rotate(q, minus(p, this.centre)));
    const half = Math.tan(this.fovY / 2);
    const [near, far] = this.depths;
    const slopes = [half * (this.aspect - 2 * MARGIN), half * (1 - 2 * MARGIN)];
    let depth = Math.max(wanted[2], near);
    for (const axis of [0, 1]) {
      // x + a <= h (z + d) and -(x + a) <= h (z + d) for all points: possible for some a from this d on
      const h = slopes[axis];
      let right = -Infinity, left = -Infinity;
      for (const p of points) {
        right = Math.max(right, p[axis] - h * p[2]);
        left = Math.max(left, -p[axis] - h * p[2]);
      }
      if (points.length) depth = Math.max(depth, (right + left) / (2 * h));
    }
    depth = Math.min(depth, Math.max(far, near));
    const fitted = [wanted[0], wanted[1], depth];
    for (const axis of [0, 1]) {
      const h = slopes[axis];
      let low = -Infinity, high = Infinity;
      for (const p of points) {
        high = Math.min(high, h * (p[2] + depth) - p[axis]);
        low = Math.max(low, -h * (p[2] + depth) - p[axis]);
      }
      fitted[axis] = low <= high ? clamp(wanted[axis], low, high) : (low + high) / 2;
    }
    return fitted;
  }
}
