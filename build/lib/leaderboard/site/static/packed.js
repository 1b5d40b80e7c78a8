/* What `leaderboard/site/packed.py` packed: base64, DEFLATE, then whole numbers as zigzag variable-length bytes. */

FreeArt.unpack = async (base64) => {
  const text = atob(base64), deflated = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) deflated[i] = text.charCodeAt(i);
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = bytes[0] | (bytes[1] << 8) | (bytes[2] << 16) | (bytes[3] << 24);
  const body = bytes.subarray(4 + length);

  const whole = ([at, size]) => {
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
    curve: ({ low, step, at }) => summed(whole(at)).map((level) => low + step * level),
    poses({ scale, columns }) {
      return columns[0].map((_, i) => [0, 4, 8].map((row) => [0, 1, 2, 3].map((k) => scale[row + k] * columns[row + k][i])));
    },
    mesh({ low, step, vertices: places, faces: corners }) {
      const places_ = whole(places), n = places_.length / 3;
      const columns = [0, 1, 2].map((k) => summed(places_.slice(k * n, (k + 1) * n)));
      const vertices = new Float32Array(3 * n);
      for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++) vertices[3 * i + k] = low[k] + step * columns[k][i];
      const steps = whole(corners), m = steps.length / 3;
      const first = summed(steps.slice(0, m)), faces = new Uint32Array(3 * m);
      for (let i = 0; i < m; i++) {
        faces[3 * i] = first[i];
        faces[3 * i + 1] = first[i] + steps[m + i];
        faces[3 * i + 2] = first[i] + steps[2 * m + i];
      }
      return { vertices, faces };
    },
    labels: ({ at }) => whole(at),
  };
  const header = new TextDecoder().decode(bytes.subarray(4, 4 + length));
  return JSON.parse(header, (_, value) => (value && value.$ ? kinds[value.$](value) : value));
};

/** Label maps as `Packed.labels` wrote their runs: one Uint8Array a frame. */
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
