// The view in a headset: the camera's picture on a panel, a line of status below it, both controllers, a floor.
// WebGL2, drawn once for each eye.

import { add, clamp, rotate } from "./hand.js";

const PANEL_WIDTH = 2; // m
const PANEL_HEIGHT = 1.3; // m, of a picture that is as high as wide
const PANEL_AWAY = 1.5; // m: 67 degrees wide, so that the head need not turn
const STATUS_HEIGHT = 0.34; // m
const GAP = 0.03; // m
const NIGHT = [0.055, 0.062, 0.075];
const [BOARD, INK, PALE] = ["#15181d", "#f2f4f7", "#aab2bf"];
const STATUS_PIXELS = [1280, 218]; // letters of 5 cm: 1.3 degrees and more

const LIT = [
  `#version 300 es
uniform mat4 projection, view, model;
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 normal;
out vec3 facing;
out vec3 inRoom;
void main() {
  vec4 there = model * vec4(place, 1.0);
  inRoom = there.xyz;
  facing = mat3(model) * normal;
  gl_Position = projection * view * there;
}`,
  `#version 300 es
precision highp float;
uniform vec3 colour;
uniform float grid;
uniform vec3 night;
in vec3 facing;
in vec3 inRoom;
out vec4 shown;
void main() {
  float light = 0.55 + 0.45 * max(dot(normalize(facing), normalize(vec3(0.3, 1.0, 0.4))), 0.0);
  shown = vec4(colour * light, 1.0);
  if (grid > 0.0) {
    vec2 cell = abs(fract(inRoom.xz * 2.0 - 0.5) - 0.5) / fwidth(inRoom.xz * 2.0);
    float line = 1.0 - min(min(cell.x, cell.y), 1.0);
    float near = 1.0 - smoothstep(0.5, 6.0, length(inRoom.xz));
    shown = vec4(mix(night, colour * (1.0 + 1.2 * line), near), 1.0);
  }
}`,
];
const PRINTED = [
  `#version 300 es
uniform mat4 projection, view, model;
layout(location = 0) in vec3 place;
out vec2 at;
void main() {
  at = vec2(place.x + 0.5, 0.5 - place.y);
  gl_Position = projection * view * model * vec4(place, 1.0);
}`,
  `#version 300 es
precision highp float;
uniform sampler2D print;
in vec2 at;
out vec4 shown;
void main() { shown = vec4(texture(print, at).rgb, 1.0); }`,
];

/** The scene in a WebGL2 context. */
export class Room {
  /** @param gl A context made for a headset (`xrCompatible`). */
  constructor(gl) {
    this.gl = gl;
    this.lit = program(gl, LIT);
    this.printed = program(gl, PRINTED);
    this.box = mesh(gl, boxVertices());
    this.sheet = mesh(gl, sheetVertices());
    this.picture = texture(gl);
    this.status = texture(gl);
    this.board = document.createElement("canvas");
    [this.board.width, this.board.height] = STATUS_PIXELS;
    this.aspect = 16 / 9;
    this.panel = null;
  }

  /** Place the panel: `centre` (3,) m, `turn` the quaternion of the head's heading. */
  hang(centre, turn) {
    const ahead = rotate(turn, [0, 0, -PANEL_AWAY]);
    this.panel = { position: add(centre, ahead), quaternion: turn };
  }

  /** Show a new picture of the camera (ImageBitmap, or any source of a texture). */
  show(picture) {
    this.aspect = picture.width / picture.height;
    print(this.gl, this.picture, picture);
  }

  /** Redraw the line of status; `facts` as for `drawStatus`. */
  tell(facts) {
    drawStatus(this.board.getContext("2d"), facts);
    print(this.gl, this.status, this.board);
  }

  /**
   * Draw the scene for each view of a frame.
   * @param layer The session's XRWebGLLayer.
   * @param views Of an XRViewerPose.
   * @param controllers [{position, quaternion, colour: [r, g, b]}].
   * @param floor Whether the room's height zero is the floor.
   */
  draw(layer, views, controllers, floor) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(...NIGHT, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    for (const view of views) {
      const { x, y, width, height } = layer.getViewport(view);
      gl.viewport(x, y, width, height);
      this.eye = [view.projectionMatrix, view.transform.inverse.matrix];
      if (floor) this.solid(this.sheet, model([0, 0, 0], [Math.SQRT1_2, -Math.SQRT1_2, 0, 0], [16, 16, 1]), [0.1, 0.11, 0.13], 1);
      for (const one of controllers) this.controller(one);
      if (this.panel) this.wall();
    }
  }

  wall() {
    const { position, quaternion } = this.panel;
    const width = Math.min(PANEL_WIDTH, PANEL_HEIGHT * this.aspect);
    const height = width / this.aspect;
    const place = (down, back) => {
      return add(position, rotate(quaternion, [0, -down, -back]));
    };
    const under = height / 2 + GAP + STATUS_HEIGHT / 2;
    this.solid(this.box, model(place(0, 0.012), quaternion, [width + 0.03, height + 0.03, 0.01]), [0.2, 0.22, 0.26]);
    this.paper(this.picture, model(place(0, 0), quaternion, [width, height, 1]));
    this.paper(this.status, model(place(under, 0), quaternion, [PANEL_WIDTH, STATUS_HEIGHT, 1]));
  }

  controller({ position, quaternion, colour }) {
    const ahead = rotate(quaternion, [0, 0.012, -0.055]);
    this.solid(this.box, model(position, quaternion, [0.03, 0.035, 0.11]), colour);
    this.solid(this.box, model(add(position, ahead), quaternion, [0.05, 0.016, 0.05]), colour);
  }

  solid(shape, matrix, colour, grid = 0) {
    const { gl, lit } = this;
    gl.useProgram(lit.name);
    this.aim(lit, matrix);
    gl.uniform3fv(lit.at("colour"), colour);
    gl.uniform1f(lit.at("grid"), grid);
    gl.uniform3fv(lit.at("night"), NIGHT);
    shape.draw();
  }

  paper(sheet, matrix) {
    const { gl, printed } = this;
    gl.useProgram(printed.name);
    this.aim(printed, matrix);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, sheet);
    gl.uniform1i(printed.at("print"), 0);
    this.sheet.draw();
  }

  aim(used, matrix) {
    this.gl.uniformMatrix4fv(used.at("projection"), false, this.eye[0]);
    this.gl.uniformMatrix4fv(used.at("view"), false, this.eye[1]);
    this.gl.uniformMatrix4fv(used.at("model"), false, matrix);
  }
}

/**
 * The status below the picture.
 * @param facts {recording, paused, seconds, state, limits, joint (type), notice, latency (ms or null), lines (two)}.
 */
export function drawStatus(context, facts) {
  const { width, height } = context.canvas;
  const [first, second, third] = [52, 122, 178];
  const write = (font, colour, text, left, middle, most) => {
    context.font = `${font} system-ui, sans-serif`;
    context.fillStyle = colour;
    context.fillText(text, left, middle, most);
  };
  context.fillStyle = BOARD;
  context.fillRect(0, 0, width, height);
  context.textBaseline = "middle";
  context.fillStyle = facts.recording ? "#ff4d4d" : facts.paused ? "#f0b429" : "#5b6472";
  context.beginPath();
  context.arc(56, first, 20, 0, 2 * Math.PI);
  context.fill();
  write("600 46px", INK, clock(facts.seconds), 96, first);
  write("36px", PALE, facts.recording ? "recording" : facts.paused ? "paused" : "not recording", 218, first);
  bar(context, 500, first, 480, facts);
  write("36px", INK, reading(facts), 1006, first);
  context.textAlign = "right";
  write("36px", PALE, facts.latency === null ? "" : `${Math.round(facts.latency)} ms`, width - 36, first);
  context.textAlign = "left";
  write("32px", facts.notice ? INK : PALE, facts.notice ?? facts.lines[0], 36, second, width - 72);
  write("32px", PALE, facts.notice ? facts.lines[0] : facts.lines[1], 36, third, width - 72);
}

function bar(context, left, middle, width, { state, limits }) {
  const [low, high] = limits;
  const share = high > low ? clamp((state - low) / (high - low), 0, 1) : 0;
  context.fillStyle = "#2b313b";
  context.fillRect(left, middle - 11, width, 22);
  context.fillStyle = "#4da3ff";
  context.fillRect(left, middle - 11, share * width, 22);
  context.fillStyle = INK;
  context.fillRect(left + share * width - 3, middle - 19, 6, 38);
}

function reading({ state, joint }) {
  return joint === "prismatic" ? `${(1000 * state).toFixed(0)} mm` : `${((180 / Math.PI) * state).toFixed(0)}\u00b0`;
}

/** Minutes and seconds. */
export function clock(seconds) {
  const whole = Math.floor(seconds || 0);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** A 4x4 matrix, column by column, of a scale, then a rotation, then a translation. */
export function model(position, quaternion, scale) {
  const column = (axis) => rotate(quaternion, axis);
  const x = column([scale[0], 0, 0]);
  const y = column([0, scale[1], 0]);
  const z = column([0, 0, scale[2]]);
  return new Float32Array([...x, 0, ...y, 0, ...z, 0, ...position, 1]);
}

function program(gl, [vertex, fragment]) {
  const name = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(name, shader);
  }
  gl.linkProgram(name);
  if (!gl.getProgramParameter(name, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(name));
  const places = new Map();
  const at = (uniform) => {
    if (!places.has(uniform)) places.set(uniform, gl.getUniformLocation(name, uniform));
    return places.get(uniform);
  };
  return { name, at };
}

/** Triangles of `vertices`, six numbers each: position and normal. */
function mesh(gl, vertices) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(vertices), gl.STATIC_DRAW);
  for (const k of [0, 1]) {
    gl.enableVertexAttribArray(k);
    gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 24, 12 * k);
  }
  gl.bindVertexArray(null);
  const draw = () => {
    gl.bindVertexArray(array);
    gl.drawArrays(gl.TRIANGLES, 0, vertices.length / 6);
    gl.bindVertexArray(null);
  };
  return { draw };
}

const CORNERS = [
  [-0.5, -0.5],
  [0.5, -0.5],
  [0.5, 0.5],
  [-0.5, -0.5],
  [0.5, 0.5],
  [-0.5, 0.5],
];

/** A square of side 1 about the origin, facing z. */
function sheetVertices() {
  return CORNERS.flatMap(([x, y]) => [x, y, 0, 0, 0, 1]);
}

/** A cube of side 1 about the origin. */
function boxVertices() {
  const out = [];
  for (const axis of [0, 1, 2]) {
    for (const side of [-0.5, 0.5]) {
      const normal = [0, 0, 0];
      normal[axis] = 2 * side;
      for (const [a, b] of CORNERS) {
        const place = [0, 0, 0];
        place[axis] = side;
        place[(axis + 1) % 3] = a;
        place[(axis + 2) % 3] = b;
        out.push(...place, ...normal);
      }
    }
  }
  return out;
}

function texture(gl) {
  const name = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, name);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([24, 27, 32, 255]));
  for (const [what, how] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
    [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ]) {
    gl.texParameteri(gl.TEXTURE_2D, what, how);
  }
  return name;
}

function print(gl, name, source) {
  gl.bindTexture(gl.TEXTURE_2D, name);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, source);
}
