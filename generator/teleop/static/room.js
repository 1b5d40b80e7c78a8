// The view in a headset: the camera's picture on a panel, a line of status below it, both controllers.
// WebGL2, drawn once for each eye.

import { add, rotate } from "./hand.js";

const PANEL_WIDTH = 2; // m
const PANEL_HEIGHT = 1.3; // m, of a picture that is as high as wide
const PANEL_AWAY = 1.5; // m: 67 degrees wide, so that the head need not turn
const STATUS_HEIGHT = 0.34; // m
const GAP = 0.03; // m
const NIGHT = [0.055, 0.062, 0.075];
const [BOARD, INK, PALE] = ["#15181d", "#f2f4f7", "#aab2bf"];
const STATUS_PIXELS = [1280, 218]; // letters of 5 cm: 1.3 degrees and more

const SHADERS = [
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
    this.program = program(gl, SHADERS);
    this.at = (name) => gl.getUniformLocation(this.program, name);
    this.box = mesh(gl, boxVertices());
    this.sheet = mesh(gl, CORNERS.flatMap(([x, y]) => [x, y, 0]));
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

  /** A texture of one colour, [r, g, b] from 0 to 255. */
  colour(rgb) {
    return texture(this.gl, rgb);
  }

  /**
   * Draw the scene for each view of a frame.
   * @param layer The session's XRWebGLLayer.
   * @param views Of an XRViewerPose.
   * @param controllers [{position, quaternion, colour: a texture}].
   */
  draw(layer, views, controllers) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(...NIGHT, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program);
    gl.uniform1i(this.at("print"), 0);
    for (const view of views) {
      const { x, y, width, height } = layer.getViewport(view);
      gl.viewport(x, y, width, height);
      gl.uniformMatrix4fv(this.at("projection"), false, view.projectionMatrix);
      gl.uniformMatrix4fv(this.at("view"), false, view.transform.inverse.matrix);
      for (const { position, quaternion, colour } of controllers) {
        this.paint(this.box, colour, model(position, quaternion, [0.03, 0.035, 0.11]));
      }
      if (this.panel) this.wall();
    }
  }

  wall() {
    const { position, quaternion } = this.panel;
    const width = Math.min(PANEL_WIDTH, PANEL_HEIGHT * this.aspect);
    const height = width / this.aspect;
    const under = add(position, rotate(quaternion, [0, -(height / 2 + GAP + STATUS_HEIGHT / 2), 0]));
    this.paint(this.sheet, this.picture, model(position, quaternion, [width, height, 1]));
    this.paint(this.sheet, this.status, model(under, quaternion, [PANEL_WIDTH, STATUS_HEIGHT, 1]));
  }

  paint(shape, print, matrix) {
    const { gl } = this;
    gl.uniformMatrix4fv(this.at("model"), false, matrix);
    gl.bindTexture(gl.TEXTURE_2D, print);
    shape();
  }
}

/**
 * The status below the picture.
 * @param facts {recording, paused, seconds, state, joint (type), notice, lines (two)}.
 */
export function drawStatus(context, facts) {
  const { width, height } = context.canvas;
  const write = (font, colour, text, left, middle, most) => {
    context.font = `${font} system-ui, sans-serif`;
    context.fillStyle = colour;
    context.fillText(text, left, middle, most);
  };
  context.fillStyle = BOARD;
  context.fillRect(0, 0, width, height);
  context.textBaseline = "middle";
  write("60px", facts.recording ? "#ff4d4d" : facts.paused ? "#f0b429" : "#5b6472", "\u25cf", 36, 52);
  write("600 46px", INK, clock(facts.seconds), 96, 52);
  write("36px", PALE, facts.recording ? "recording" : facts.paused ? "paused" : "not recording", 218, 52);
  write("36px", INK, reading(facts), 1006, 52);
  write("32px", facts.notice ? INK : PALE, facts.notice ?? facts.lines[0], 36, 122, width - 72);
  write("32px", PALE, facts.notice ? facts.lines[0] : facts.lines[1], 36, 178, width - 72);
}

function reading({ state, joint }) {
  return joint === "prismatic" ? `${(1000 * state).toFixed(0)} mm` : `${((180 / Math.PI) * state).toFixed(0)}\u00b0`;
}

/** Minutes and seconds. */
function clock(seconds) {
  const whole = Math.floor(seconds || 0);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** A 4x4 matrix, column by column, of a scale, then a rotation, then a translation. */
function model(position, quaternion, scale) {
  const column = (axis) => rotate(quaternion, axis);
  const x = column([scale[0], 0, 0]);
  const y = column([0, scale[1], 0]);
  const z = column([0, 0, scale[2]]);
  return new Float32Array([...x, 0, ...y, 0, ...z, 0, ...position, 1]);
}

function program(gl, [vertex, fragment]) {
  const name = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(name, shader);
  }
  gl.linkProgram(name);
  if (!gl.getProgramParameter(name, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(name));
  return name;
}

/** A function that draws the triangles of `vertices`, three numbers each. */
function mesh(gl, vertices) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(vertices), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
  return () => {
    gl.bindVertexArray(array);
    gl.drawArrays(gl.TRIANGLES, 0, vertices.length / 3);
  };
}

const CORNERS = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];

/** A cube of side 1 about the origin. */
function boxVertices() {
  const out = [];
  for (const axis of [0, 1, 2]) {
    for (const side of [-0.5, 0.5]) {
      for (const [a, b] of CORNERS) {
        const place = [0, 0, 0];
        place[axis] = side;
        place[(axis + 1) % 3] = a;
        place[(axis + 2) % 3] = b;
        out.push(...place);
      }
    }
  }
  return out;
}

function texture(gl, rgb = [24, 27, 32]) {
  const name = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, name);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([...rgb, 255]));
  for (const what of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, what, gl.LINEAR);
  for (const what of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, what, gl.CLAMP_TO_EDGE);
  return name;
}

function print(gl, name, source) {
  gl.bindTexture(gl.TEXTURE_2D, name);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, source);
}
