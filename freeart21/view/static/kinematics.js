/* Rigid motions as flat row-major 4x4 matrices, and where the links of a scene stand. */

const Kinematics = {
  identity: () => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],

  multiply(a, b) {
    const c = new Array(16).fill(0);
    for (let i = 0; i < 4; i++)
      for (let j = 0; j < 4; j++)
        for (let k = 0; k < 4; k++) c[4 * i + j] += a[4 * i + k] * b[4 * k + j];
    return c;
  },

  /** The displacement of a joint {type, axis, pivot} at state q, rad or m. */
  motion(joint, q) {
    const [x, y, z] = joint.axis;
    if (joint.type === "prismatic") return [1, 0, 0, q * x, 0, 1, 0, q * y, 0, 0, 1, q * z, 0, 0, 0, 1];
    const s = Math.sin(q), c = 1 - Math.cos(q);
    const R = [
      1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y,
      c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x,
      c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y),
    ];
    const p = joint.pivot;
    const t = [0, 1, 2].map((i) => p[i] - R[3 * i] * p[0] - R[3 * i + 1] * p[1] - R[3 * i + 2] * p[2]);
    return [R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1], R[6], R[7], R[8], t[2], 0, 0, 0, 1];
  },

  /** World from link for all links, parents first, when the sliders stand at `values`. */
  linkPoses(links, values) {
    const poses = [];
    for (const link of links) {
      let T = link.T_parent_link.flat();
      if (link.parent >= 0) T = Kinematics.multiply(poses[link.parent], T);
      if (link.joint) {
        const q = link.offset + (link.slider >= 0 ? link.scale * values[link.slider] : 0);
        T = Kinematics.multiply(T, Kinematics.motion(link.joint, q));
      }
      poses.push(T);
    }
    return poses;
  },

  /** The perspective of a pinhole camera {K, width, height}, fitted into a window of the given aspect. */
  pinhole(camera, aspect, near, far) {
    const { K, width, height } = camera;
    const own = width / height;
    const sx = aspect > own ? own / aspect : 1, sy = aspect > own ? 1 : aspect / own;
    return [
      (sx * 2 * K[0][0]) / width, 0, sx * (1 - (2 * K[0][2]) / width), 0,
      0, (sy * 2 * K[1][1]) / height, sy * ((2 * K[1][2]) / height - 1), 0,
      0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near),
      0, 0, -1, 0,
    ];
  },
};

