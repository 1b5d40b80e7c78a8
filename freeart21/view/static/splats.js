"use strict";
/* Gaussians in the 3D view: projected as ellipses (Zwicker et al. 2001), blended from the farthest to the nearest. */

const SPLAT_VERTEX_SHADER = `#version 300 es
precision highp float;
uniform highp usampler2D order;        // what is drawn, farthest first: 2 i is Gaussian i where it is, 2 i + 1 moved
uniform highp sampler2D shapes;        // four texels a Gaussian: mean, part weight; covariance; normal
uniform sampler2D colours;             // one: colour, opacity
uniform mat4 views[2], projection;
uniform vec2 size;                     // of the picture, pixels
uniform vec3 tints[2];
uniform float tinted, faintest, turned_away;
uniform mat4 cameras[2];               // the video's camera from both links, in the frame that is shown
uniform vec3 light[25];
uniform int terms;                     // of the light; none is the same light everywhere
out vec2 v_at;
out vec4 v_colour;

/* freeart21.gaussians.spherical_harmonics, summed with the light's coefficients. */
vec3 lit(vec3 n) {
  float x = n.x, y = n.y, z = n.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 sum = 0.28209479177387814 * light[0];
  if (terms > 1) sum += 0.4886025119029199 * (y * light[1] + z * light[2] + x * light[3]);
  if (terms > 4)
    sum += 1.0925484305920792 * (x * y * light[4] + y * z * light[5] + x * z * light[7])
      + 0.31539156525252005 * (3.0 * zz - 1.0) * light[6] + 0.5462742152960396 * (xx - yy) * light[8];
  if (terms > 9)
    sum += 0.5900435899266435 * (y * (3.0 * xx - yy) * light[9] + x * (xx - 3.0 * yy) * light[15])
      + 2.890611442640554 * x * y * z * light[10] + 1.445305721320277 * z * (xx - yy) * light[14]
      + 0.4570457994644658 * (5.0 * zz - 1.0) * (y * light[11] + x * light[13])
      + 0.3731763325901154 * z * (5.0 * zz - 3.0) * light[12];
  if (terms > 16)
    sum += 2.5033429417967046 * x * y * (xx - yy) * light[16]
      + 1.7701307697799304 * z * (y * (3.0 * xx - yy) * light[17] + x * (xx - 3.0 * yy) * light[23])
      + (7.0 * zz - 1.0) * (0.9461746957575601 * x * y * light[18] + 0.47308734787878004 * (xx - yy) * light[22])
      + 0.6690465435572892 * z * (7.0 * zz - 3.0) * (y * light[19] + x * light[21])
      + 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0) * light[20]
      + 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)) * light[24];
  return sum;
}

vec4 shape(int texel) {
  int width = textureSize(shapes, 0).x;
  return texelFetch(shapes, ivec2(texel % width, texel / width), 0);
}

void main() {
  int k = gl_VertexID / 3, width = textureSize(order, 0).x;
  uint copy = texelFetch(order, ivec2(k % width, k / width), 0).r;
  int i = int(copy >> 1), moved = int(copy & 1u);
  vec4 a = shape(4 * i), b = shape(4 * i + 1), c = shape(4 * i + 2);
  vec4 colour = texelFetch(colours, ivec2(i % width, i / width), 0);
  float opacity = min(0.999, colour.a * (moved == 1 ? 1.0 - a.w : a.w));
  mat4 view = moved == 1 ? views[1] : views[0];
  vec4 p = view * vec4(a.xyz, 1.0);
  vec4 clip = projection * p;
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);              // outside
  vec3 normal = shape(4 * i + 3).xyz;
  if (dot(mat3(view) * normal, -p.xyz) < turned_away * length(p.xyz)) return; // zero, where it has no outer face
  if (opacity < faintest || p.z > -1e-4 || clip.z < -clip.w || abs(clip.x) > 1.4 * clip.w || abs(clip.y) > 1.4 * clip.w) return;
  vec2 focal = vec2(projection[0][0], projection[1][1]) * size / 2.0, limit = 1.3 * size / (2.0 * focal);
  vec2 slope = clamp(p.xy / -p.z, -limit, limit);      // where the linear camera still resembles the real one
  mat3 J = mat3(focal.x, 0.0, 0.0, 0.0, focal.y, 0.0, focal * slope, 0.0) * (1.0 / -p.z);
  mat3 T = J * mat3(view);
  mat3 cov = T * mat3(b.x, b.y, b.z, b.y, b.w, c.x, b.z, c.x, c.y) * transpose(T);
  float xx = cov[0][0] + 0.3, xy = cov[0][1], yy = cov[1][1] + 0.3;
  float middle = (xx + yy) / 2.0, apart = length(vec2((xx - yy) / 2.0, xy));
  float large = middle + apart, small = max(middle - apart, 0.05);
  vec2 along = apart < 1e-6 * middle ? vec2(1.0, 0.0) : normalize(xx > yy ? vec2(large - yy, xy) : vec2(xy, large - xx));
  float reach = sqrt(2.0 * log(opacity / faintest));   // fainter beyond it
  vec2 corners[3] = vec2[3](vec2(0.0, 2.0), vec2(-1.7320508, -1.0), vec2(1.7320508, -1.0)); // a triangle around a circle
  v_at = corners[gl_VertexID % 3] * reach;
  vec2 pixels = v_at.x * sqrt(large) * along + v_at.y * sqrt(small) * vec2(-along.y, along.x);
  if (terms > 0) colour.rgb = clamp(colour.rgb * lit(mat3(moved == 1 ? cameras[1] : cameras[0]) * normal), 0.0, 1.0);
  float grey = dot(colour.rgb, vec3(0.299, 0.587, 0.114));
  v_colour = vec4(mix(colour.rgb, tints[moved] * (0.35 + 0.65 * sqrt(grey)), tinted), opacity);
  gl_Position = clip + vec4(pixels * 2.0 / size * clip.w, 0.0, 0.0);
  gl_Position.z = min(gl_Position.z, gl_Position.w);   // however far
}`;

const SPLAT_FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec2 v_at;
in vec4 v_colour;
uniform float faintest;
out vec4 result;
void main() {
  float alpha = v_colour.a * exp(-0.5 * dot(v_at, v_at));
  if (alpha < faintest) discard;
  result = vec4(v_colour.rgb * alpha, alpha);
}`;

const Splats = {
  /** {count, shapes, colours, copies}: means, covariances, normals and colours as textures of the shader. */
  unpack(data, array) {
    const means = array(data.means), scales = array(data.scales), quaternions = array(data.quaternions);
    const colours = array(data.colours), opacities = array(data.opacities), weights = array(data.part_weights);
    const normals = data.normals && array(data.normals);
    const count = opacities.length, [least, most] = data.scales_between;
    const shapes = new Float32Array(16 * count), packed = new Uint8Array(4 * count), copies = new Uint32Array(2 * count);
    const variance = Float64Array.from({ length: 256 }, (_, k) => Math.exp(2 * (least + ((most - least) * k) / 255)));
    let n = 0;
    for (let i = 0; i < count; i++) {
      const at = 16 * i;
      for (let k = 0; k < 3; k++) {
        shapes[at + k] = means[3 * i + k];
        packed[4 * i + k] = colours[3 * i + k];
      }
      packed[4 * i + 3] = opacities[i];
      let [w, x, y, z] = [0, 1, 2, 3].map((k) => quaternions[4 * i + k] - 128);
      const length = Math.hypot(w, x, y, z) || 1;
      w /= length; x /= length; y /= length; z /= length;
      const R = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
      ];
      const [a, b, c] = [0, 1, 2].map((k) => variance[scales[3 * i + k]]);
      const entry = (r, s) => a * R[3 * r] * R[3 * s] + b * R[3 * r + 1] * R[3 * s + 1] + c * R[3 * r + 2] * R[3 * s + 2];
      shapes.set([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)], at + 4);
      if (normals) {
        const normal = [0, 1, 2].map((k) => normals[3 * i + k] - 128), size = Math.hypot(...normal) || 1;
        shapes.set(normal.map((x) => x / size), at + 12);
      }
      const weight = weights[i] / 255, opacity = opacities[i] / 255;
      shapes[at + 3] = weight;
      if (opacity * weight > data.faint_copy) copies[n++] = 2 * i;
      if (opacity * (1 - weight) > data.faint_copy) copies[n++] = 2 * i + 1;
    }
    return { count, shapes, colours: packed, copies: copies.slice(0, n) };
  },

  /** Puts the copies that are shown into `order`, farthest first; `views` are row-major viewer from link. Returns their number. */
  sort(splats, views, shown, order, room) {
    const { shapes, copies } = splats, { depths, counts } = room;
    let least = Infinity, most = -Infinity, n = 0;
    for (let k = 0; k < copies.length; k++) {
      const copy = copies[k], view = views[copy & 1], at = 16 * (copy >> 1);
      if (!shown[copy & 1]) continue;
      const z = view[8] * shapes[at] + view[9] * shapes[at + 1] + view[10] * shapes[at + 2] + view[11];
      depths[n] = z;
      room.kept[n++] = copy;
      if (z < least) least = z;
      if (z > most) most = z;
    }
    const steps = counts.length - 1, scale = most > least ? (steps - 1) / (most - least) : 0;
    counts.fill(0);
    for (let k = 0; k < n; k++) counts[((depths[k] - least) * scale | 0) + 1]++;
    for (let k = 1; k <= steps; k++) counts[k] += counts[k - 1];
    for (let k = 0; k < n; k++) order[counts[(depths[k] - least) * scale | 0]++] = room.kept[k];
    return n;
  },

  /** Draws the Gaussians `data` with the WebGL 2 context `gl`. */
  renderer(gl, data, program, tints) {
    const splats = Splats.unpack(data, FreeArt.array);
    const uniform = Object.fromEntries(
      ["shapes", "colours", "order", "views[0]", "projection", "size", "tints[0]", "tinted", "faintest", "turned_away", "cameras[0]", "light[0]", "terms"]
        .map((name) => [name, gl.getUniformLocation(program, name)]));
    const n = splats.copies.length, width = 1024, rows = (texels) => Math.max(1, Math.ceil(texels / width));
    const texture = (unit, values, texels, inside, format, type) => {
      const channels = values.length / texels, whole = new values.constructor(channels * width * rows(texels));
      whole.set(values);
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, rows(texels), 0, format, type, whole);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    };
    texture(1, splats.shapes, 4 * splats.count, gl.RGBA32F, gl.RGBA, gl.FLOAT);
    texture(2, splats.colours, splats.count, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE);
    texture(3, splats.copies, n, gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT);
    gl.activeTexture(gl.TEXTURE0);
    const order = new Uint32Array(width * rows(n));
    const room = { depths: new Float32Array(n), kept: new Uint32Array(n), counts: new Uint32Array((1 << 16) + 1) };
    const vertices = gl.createVertexArray();               // empty: one triangle each from textures is the fastest
    let last = "", count = 0;

    const paint = (faintest) => {
      gl.uniform1f(uniform.faintest, faintest);
      gl.bindVertexArray(vertices);
      gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
    };
    /** Draws them behind and in front of what is there; the depth buffer stays as it is. */
    const draw = (frame, across, down) => {
      const views = data.links.map((link) => Kinematics.multiply(frame.view, frame.poses[link]));
      const shown = data.layers.map((layer) => frame.shown[layer]);
      const now = [...views.flat(), ...shown].join();
      gl.useProgram(program);
      if (now !== last) {
        count = Splats.sort(splats, views, shown, order, room);
        gl.activeTexture(gl.TEXTURE3);
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, rows(count), gl.RED_INTEGER, gl.UNSIGNED_INT, order);
        gl.activeTexture(gl.TEXTURE0);
        last = now;
      }
      gl.uniform1i(uniform.shapes, 1);
      gl.uniform1i(uniform.colours, 2);
      gl.uniform1i(uniform.order, 3);
      gl.uniformMatrix4fv(uniform["views[0]"], true, views.flat());
      gl.uniformMatrix4fv(uniform.projection, true, frame.projection);
      gl.uniform2f(uniform.size, across, down);
      gl.uniform1f(uniform.turned_away, data.turned_away);
      gl.uniform3fv(uniform["tints[0]"], tints.flat());
      gl.uniform1f(uniform.tinted, frame.partColours ? 1 : 0);
      gl.uniform1i(uniform.terms, data.light ? data.light.length : 0);
      if (data.light) {                                    // without a video the viewer is its camera
        const camera = frame.camera ?? frame.view.map((x, k) => (k >= 4 && k < 12 ? -x : x));
        const cameras = data.links.map((link) => Kinematics.multiply(camera, frame.poses[link]));
        gl.uniformMatrix4fv(uniform["cameras[0]"], true, cameras.flat());
        gl.uniform3fv(uniform["light[0]"], data.light.flat());
      }
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      gl.depthMask(false);
      gl.depthFunc(gl.LEQUAL);
      paint(1 / 255);
    };
    /** Writes the depth of their opaque parts, as drawn last, for what is drawn later. */
    const drawDepth = () => {
      gl.useProgram(program);
      gl.colorMask(false, false, false, false);
      gl.depthMask(true);
      paint(0.5);
      gl.colorMask(true, true, true, true);
    };
    return { draw, drawDepth };
  },
};

