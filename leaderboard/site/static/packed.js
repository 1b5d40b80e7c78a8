/* Reads the output of `leaderboard/site/packed.py`: base64, DEFLATE, then integers as zigzag variable-length bytes. */

FreeArt.unpack = async (base64) => {
  const deflated = FreeArt.array({ base64, dtype: "u8" });
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = bytes[0] | (bytes[1] << 8) | (bytes[2] << 16) | (bytes[3] << 24);
  const body = bytes.subarray(4 + length);

  const integers = ([at, size]) => {
    const found = [];
    for (let i = at, value = 0, unit = 1; i < at + size; i++) {
      value += (body[i] & 127) * unit;
      unit *= 128;
      if (body[i] < 128) {
        found.push(value % 2 ? -(value + 1) / 2 : value / 2);
        value = 0;
        unit = 1;
      }
    }
    return found;
  };
  const summed = (values) => {
    let sum = 0;
    return values.map((value) => (sum += value));
  };
  const kinds = {
    curve: ({ low, step, at }) => summed(integers(at)).map((level) => low + step * level),
    poses({ scale, columns }) {
      return columns[0].map((_, i) => [0, 4, 8].map((row) => [0, 1, 2, 3].map((k) => scale[row + k] * columns[row + k][i])));
    },
    lines: ({ gaps, columns }) => gaps.map((gap, i) => (gap ? null : columns.map((column) => column[i]))),
    mesh({ low, step, vertices: places, faces: corners }) {
      const all = integers(places), n = all.length / 3;
      const columns = [0, 1, 2].map((k) => summed(all.slice(k * n, (k + 1) * n)));
      const vertices = new Float32Array(3 * n);
      for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++) vertices[3 * i + k] = low[k] + step * columns[k][i];
      const steps = integers(corners), m = steps.length / 3;
      const first = summed(steps.slice(0, m)), faces = new Uint32Array(3 * m);
      for (let i = 0; i < m; i++) {
        faces[3 * i] = first[i];
        faces[3 * i + 1] = first[i] + steps[m + i];
        faces[3 * i + 2] = first[i] + steps[2 * m + i];
      }
      return { vertices, faces };
    },
    integers: ({ at }) => integers(at),
  };
  const header = new TextDecoder().decode(bytes.subarray(4, 4 + length));
  return JSON.parse(header, (_, value) => (value && value.$ ? kinds[value.$](value) : value));
};

/** The label maps behind the runs of `Packed.labels`: one Uint8Array a frame. */
FreeArt.labelMaps = ({ width, height, labels }) => {
  const size = width * height, maps = [];
  let map = null, at = size;
  for (const run of labels) {
    if (at === size) {
      map = new Uint8Array(size);
      maps.push(map);
      at = 0;
    }
    const end = at + Math.floor(run / 3);
    map.fill(run % 3, at, end);
    at = end;
  }
  return maps;
};
