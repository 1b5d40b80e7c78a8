/* The arrow along a joint axis, of length 1 along z, with a second one bent round it for a revolute joint. */

FreeArt.arrow = (() => {
  const tube = (rings) => {
    const vertices = [], faces = [], around = rings[0].length;
    for (const ring of rings) for (const point of ring) vertices.push(...point);
    for (let r = 0; r + 1 < rings.length; r++)
      for (let c = 0; c < around; c++) {
        const [a, b] = [r * around + c, r * around + ((c + 1) % around)];
        faces.push(a, b, b + around, a, b + around, a + around);
      }
    return { vertices, faces };
  };
  const circle = (n, at) => Array.from({ length: n }, (_, k) => at((2 * Math.PI * k) / n));
  const shaft = () => {
    const r = 0.007;
    const profile = [[0, -0.5], [r, -0.5], [r, 0.5 - 5 * r], [2.4 * r, 0.5 - 5 * r], [0, 0.5]];
    return tube(profile.map(([radius, z]) => circle(16, (a) => [radius * Math.cos(a), radius * Math.sin(a), z])));
  };
  const turn = () => {
    const r = 0.0049, ring = 0.074, height = 0.36, rings = [];
    const add = (angle, size) => rings.push(circle(8, (a) => {
      const out = ring + size * Math.cos(a);
      return [out * Math.cos(angle), out * Math.sin(angle), height + size * Math.sin(a)];
    }));
    for (let k = 0; k <= 32; k++) add((1.5 * Math.PI * k) / 32, r);
    for (let k = 0; k <= 5; k++) add(1.5 * Math.PI + (k * 5 * r) / (5 * ring), 2.4 * r * (1 - k / 5));
    return tube(rings);
  };
  return (type) => {
    const parts = type === "revolute" ? [shaft(), turn()] : [shaft()];
    const vertices = [], faces = [];
    for (const part of parts) {
      const start = vertices.length / 3;
      vertices.push(...part.vertices);
      faces.push(...part.faces.map((i) => i + start));
    }
    return { vertices: new Float32Array(vertices), faces: new Uint32Array(faces) };
  };
})();
