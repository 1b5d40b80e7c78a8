/* The 3D view: a small WebGL 2 renderer, orbit controls, a slider for every joint. */

const VERTEX_SHADER = `#version 300 es
in vec3 position, normal, colour;
in vec2 uv;
uniform mat4 view, projection;
out vec3 v_position, v_normal, v_colour;
out vec2 v_uv;
void main() {
  vec4 p = view * vec4(position, 1.0);
  v_position = p.xyz;
  v_normal = mat3(view) * normal;
  v_colour = colour;
  v_uv = uv;
  gl_Position = projection * p;
}`;

const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec3 v_position, v_normal, v_colour;
in vec2 v_uv;
uniform vec3 tint;
uniform float own, alpha;
uniform bool textured, ghost;
uniform sampler2D image;
out vec4 result;
void main() {
  vec3 base = mix(tint, textured ? texture(image, v_uv).rgb : v_colour, own);
  vec3 eye = normalize(-v_position);
  vec3 n = normalize(v_normal);
  n = dot(n, eye) < 0.0 ? -n : n;                       // surfaces have two sides
  vec3 key = normalize(vec3(-0.45, 0.75, 0.6));
  float light = 0.28 + 0.10 * n.y + 0.36 * max(dot(n, key), 0.0) + 0.24 * max(dot(n, eye), 0.0);
  float shine = 0.10 * pow(max(dot(reflect(-key, n), eye), 0.0), 28.0);
  vec3 shaded = pow(pow(base, vec3(2.2)) * light + shine, vec3(1.0 / 2.2));
  float rim = pow(1.0 - abs(dot(n, eye)), 2.0);
  result = vec4(shaded, ghost ? mix(alpha, 0.85, rim) : alpha);
  gl_FragDepth = gl_FragCoord.z + (gl_FrontFacing ? 0.0 : 2e-4); // of two coincident sides the one towards us shows
}`;

/** Triangles without shared corners, with normals that are smooth except across creases of more than 40 degrees. */
FreeArt.corners = (vertices, faces) => {
  const n = faces.length, count = n / 3;
  const key = new Map(), weld = new Uint32Array(vertices.length / 3);
  for (let v = 0; v < weld.length; v++) {
    const name = `${vertices[3 * v]},${vertices[3 * v + 1]},${vertices[3 * v + 2]}`;
    if (!key.has(name)) key.set(name, key.size);
    weld[v] = key.get(name);
  }
  const area = new Float32Array(3 * count), unit = new Float32Array(3 * count);
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * faces[3 * f + k]);
    const u = [0, 1, 2].map((k) => vertices[b + k] - vertices[a + k]);
    const w = [0, 1, 2].map((k) => vertices[c + k] - vertices[a + k]);
    const cross = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
    const length = Math.hypot(...cross) || 1;
    for (let k = 0; k < 3; k++) {
      area[3 * f + k] = cross[k];
      unit[3 * f + k] = cross[k] / length;
    }
  }
  const starts = new Uint32Array(key.size + 1);
  for (let i = 0; i < n; i++) starts[weld[faces[i]] + 1]++;
  for (let v = 0; v < key.size; v++) starts[v + 1] += starts[v];
  const fill = starts.slice(), around = new Uint32Array(n);
  for (let i = 0; i < n; i++) around[fill[weld[faces[i]]]++] = Math.floor(i / 3);
  const positions = new Float32Array(3 * n), normals = new Float32Array(3 * n);
  const crease = Math.cos((40 * Math.PI) / 180);
  for (let i = 0; i < n; i++) {
    const f = 3 * Math.floor(i / 3), v = weld[faces[i]];
    for (let at = starts[v]; at < starts[v + 1]; at++) {
      const g = 3 * around[at];
      if (unit[f] * unit[g] + unit[f + 1] * unit[g + 1] + unit[f + 2] * unit[g + 2] < crease) continue;
      for (let k = 0; k < 3; k++) normals[3 * i + k] += area[g + k];
    }
    const length = Math.hypot(normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]) || 1;
    for (let k = 0; k < 3; k++) {
      normals[3 * i + k] /= length;
      positions[3 * i + k] = vertices[3 * faces[i] + k];
    }
  }
  return { positions, normals };
};

/** Draws a scene into a canvas; null where WebGL 2 is missing. */
FreeArt.renderer = (canvas, data) => {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
  if (!gl) return null;
  const compile = (type, source) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const linked = (vertex, fragment) => {
    const program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER, vertex));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(program);
    return program;
  };
  const program = linked(VERTEX_SHADER, FRAGMENT_SHADER);
  gl.useProgram(program);
  const uniform = Object.fromEntries(["view", "projection", "tint", "own", "alpha", "textured", "ghost", "image"]
    .map((name) => [name, gl.getUniformLocation(program, name)]));
  const attribute = (name, values, size, type = gl.FLOAT, normalised = false) => {
    const at = gl.getAttribLocation(program, name);
    if (at < 0) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, size, type, normalised, 0, 0);
  };
  const gathered = (values, faces, size) => {
    const result = new values.constructor(size * faces.length);
    for (let i = 0; i < faces.length; i++)
      for (let k = 0; k < size; k++) result[size * i + k] = values[size * faces[i] + k];
    return result;
  };
  const surfaces = data.surfaces.map((surface) => {
    const vertices = FreeArt.array(surface.vertices), faces = FreeArt.array(surface.faces);
    const { positions, normals } = FreeArt.corners(vertices, faces);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    attribute("position", positions, 3);
    attribute("normal", normals, 3);
    if (surface.colours) attribute("colour", gathered(FreeArt.array(surface.colours), faces, 3), 3, gl.UNSIGNED_BYTE, true);
    if (surface.uv) attribute("uv", gathered(FreeArt.array(surface.uv), faces, 2), 2);
    return { ...surface, array, count: faces.length, painted: surface.colours !== null || surface.texture >= 0, vertices: null, faces: null };
  });
  let changed = () => {};
  const textures = data.textures.map((url) => {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([200, 200, 200, 255]));
    const image = new Image();
    image.onload = () => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, true);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      changed();
    };
    image.src = url;
    return texture;
  });
  const tint = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);
  for (const surface of surfaces) surface.tint = tint(data.layers[surface.layer].colour);
  const splats = data.gaussians && Splats.renderer(gl, data.gaussians, linked(SPLAT_VERTEX_SHADER, SPLAT_FRAGMENT_SHADER),
    data.gaussians.layers.map((layer) => tint(data.layers[layer].colour)));
  const drawLayer = (style, frame, alpha) => {
    for (const surface of surfaces) {
      const layer = data.layers[surface.layer];
      if (layer.style !== style || !frame.shown[surface.layer]) continue;
      if (frame.gaussians && data.gaussians.layers.includes(surface.layer)) continue;
      gl.bindVertexArray(surface.array);
      gl.uniformMatrix4fv(uniform.view, true, Kinematics.multiply(frame.view, frame.poses[surface.link]));
      gl.uniform3fv(uniform.tint, surface.tint);
      gl.uniform1f(uniform.own, surface.painted && !frame.partColours ? 1 : 0);
      gl.uniform1f(uniform.alpha, alpha);
      gl.uniform1i(uniform.textured, surface.texture >= 0);
      if (surface.texture >= 0) gl.bindTexture(gl.TEXTURE_2D, textures[surface.texture]);
      gl.drawArrays(gl.TRIANGLES, 0, surface.count);
    }
  };
  gl.enable(gl.DEPTH_TEST);

  /** Draw {view, projection, poses, shown, partColours, gaussians, camera}. */
  const draw = (frame) => {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.useProgram(program);
    gl.uniform1i(uniform.image, 0);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(uniform.projection, true, frame.projection);
    gl.uniform1i(uniform.ghost, 0);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LEQUAL);
    drawLayer("solid", frame, 1);
    if (frame.gaussians) {                                // axes stand among them
      drawLayer("axis", frame, 1);
      splats.draw(frame, canvas.width, canvas.height);
      gl.useProgram(program);
    }
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    gl.depthFunc(frame.gaussians ? gl.LEQUAL : gl.GREATER); // axes shine through
    drawLayer("axis", frame, 0.3);
    gl.depthMask(true);
    gl.depthFunc(gl.LEQUAL);
    if (!frame.gaussians) drawLayer("axis", frame, 1);
    else if (data.layers.some((layer, k) => layer.style === "ghost" && frame.shown[k])) {
      splats.drawDepth();
      gl.useProgram(program);
    }
    gl.colorMask(false, false, false, false);             // ghosts show their nearest surface only
    drawLayer("ghost", frame, 1);
    gl.colorMask(true, true, true, true);
    gl.depthMask(false);
    gl.uniform1i(uniform.ghost, 1);
    drawLayer("ghost", frame, 0.38);
  };
  return { draw, onChange(listener) { changed = listener; } };
};

/** A viewpoint that orbits a target: left drag or one finger turns, right drag or two fingers shift, wheel or pinch zooms. */
FreeArt.orbit = (canvas, data, changed) => {
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const unit = (a) => a.map((x) => x / (Math.hypot(...a) || 1));
  const mix = (...terms) => [0, 1, 2].map((k) => terms.reduce((sum, [s, a]) => sum + s * a[k], 0));
  const up = unit(data.up);
  const front = unit(mix([1, data.towards_viewer], [-dot(data.towards_viewer, up), up]));
  const side = cross(up, front);
  const field = (32 * Math.PI) / 180;
  const eye = { yaw: 0, pitch: 0, distance: 1, target: [0, 0, 0] };
  const fit = () => {
    const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight) || 1;
    eye.distance = (1.02 * data.radius) / Math.sin(Math.atan(Math.tan(field / 2) * Math.min(1, aspect)));
    eye.target = [...data.centre];
  };
  const home = () => {
    eye.yaw = 0;
    eye.pitch = Math.asin(FreeArt.clamp(dot(unit(data.towards_viewer), up), -1, 1));
    fit();
  };
  const axes = () => {
    const level = mix([Math.cos(eye.yaw), front], [Math.sin(eye.yaw), side]);
    const back = mix([Math.cos(eye.pitch), level], [Math.sin(eye.pitch), up]);
    const right = unit(cross(up, back));
    return { back, right, above: cross(back, right) };
  };
  const view = () => {
    const { back, right, above } = axes();
    const place = mix([1, eye.target], [eye.distance, back]);
    return [right, above, back].flatMap((axis) => [...axis, -dot(axis, place)]).concat([0, 0, 0, 1]);
  };
  const projection = (aspect) => {
    const near = Math.max(eye.distance - 4 * data.radius, eye.distance / 50), far = eye.distance + 4 * data.radius;
    const f = 1 / Math.tan(field / 2);
    return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near), 0, 0, -1, 0];
  };
  const turn = (dx, dy) => {
    eye.yaw -= 0.008 * dx;
    eye.pitch = FreeArt.clamp(eye.pitch + 0.008 * dy, -1.55, 1.55);
  };
  const shift = (dx, dy) => {
    const { right, above } = axes();
    const metres = (2 * eye.distance * Math.tan(field / 2)) / Math.max(1, canvas.clientHeight);
    eye.target = mix([1, eye.target], [-dx * metres, right], [dy * metres, above]);
  };
  const zoom = (factor) => {
    eye.distance = FreeArt.clamp(eye.distance * factor, 0.1 * data.radius, 40 * data.radius);
  };
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const dx = now[0] - before[0], dy = now[1] - before[1];
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      zoom(apart(before) / apart(now));
      shift(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.buttons & 4 || event.shiftKey) shift(dx, dy);
    else turn(dx, dy);
    fingers.set(event.pointerId, now);
    changed();
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(0.0012 * FreeArt.clamp(event.deltaY, -200, 200)));
    changed();
  }, { passive: false });
  const look = (yaw, pitch) => {
    eye.yaw = yaw;
    eye.pitch = FreeArt.clamp(pitch, -1.55, 1.55);
  };
  /* Arrows turn, with shift they move, + and - zoom, Home resets. */
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (step) (event.shiftKey ? shift : turn)(...step.map((x) => 20 * x));
    else if (event.key === "+" || event.key === "=") zoom(0.9);
    else if (event.key === "-" || event.key === "_") zoom(1 / 0.9);
    else if (event.key === "Home") home();
    else return;
    event.preventDefault();
    changed();
  });
  return { home, fit, view, projection, look };
};

FreeArt.kinds.scene = (section, data, bus) => {
  const { element } = FreeArt;
  const canvas = element("canvas", {
    tabindex: 0, role: "application",
    "aria-label": "3D view; drag or arrow keys turn, right-drag or shift and arrows move, wheel or + and - zoom, Home resets",
  });
  const frameBox = element("div", { class: "view" }, canvas);
  const legend = element("div", { class: "layers", role: "group", "aria-label": "what is shown" });
  const sliders = element("div", { class: "sliders" });
  section.querySelector("h2").after(element("div", { class: "scene" }, frameBox, element("div", { class: "panel" }, legend, sliders)));
  const renderer = FreeArt.renderer(canvas, data);
  if (!renderer) {
    frameBox.replaceChildren(element("p", { class: "notice" }, "The 3D view needs WebGL 2, which this browser does not offer."));
    return;
  }
  if (data.camera && section.classList.contains("right"))
    frameBox.style.aspectRatio = `${data.camera.width} / ${data.camera.height}`;

  const shown = data.layers.map((layer) => layer.shown);
  const values = data.sliders.map((slider) => slider.value);
  let partColours = false, gaussians = Boolean(data.gaussians), through = false, waiting = false;
  const orbit = FreeArt.orbit(canvas, data, () => {
    if (through) throughButton.click();
    redraw();
  });

  const camera = () => {                                   // camera of the video from the world, in the current frame
    const poses = data.camera_poses;
    return poses && [...poses[FreeArt.clamp(bus.frame, 0, poses.length - 1)].flat(), 0, 0, 0, 1];
  };
  const draw = () => {
    waiting = false;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const aspect = width / height;
    const frame = { poses: Kinematics.linkPoses(data.links, values), shown, partColours, gaussians, camera: camera() };
    if (through) {
      const view = frame.camera.map((x, k) => (k >= 4 && k < 12 ? -x : x)), c = data.centre;
      const depth = -(view[8] * c[0] + view[9] * c[1] + view[10] * c[2] + view[11]);
      const near = Math.max(depth - 4 * data.radius, 0.02 * Math.abs(depth), 1e-4);
      renderer.draw({ ...frame, view, projection: Kinematics.pinhole(data.camera, aspect, near, depth + 6 * data.radius) });
    } else renderer.draw({ ...frame, view: orbit.view(), projection: orbit.projection(aspect) });
  };

  const redraw = () => {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  };
  renderer.onChange(redraw);

  /* Buttons in the corner of the view. */
  const toggle = (text, title, pressed, set) => FreeArt.toggle(element("button", { type: "button", title }, text), (on) => {
    set(on);
    redraw();
  }, pressed);
  const throughButton = toggle("Video camera", "view from the camera of the video", false, (on) => { through = on; });
  const two = data.gaussians && data.gaussians.layers[0] !== data.gaussians.layers[1];
  const painted = two || data.surfaces.some((surface) => surface.colours && data.layers[surface.layer].style === "solid");
  frameBox.append(element("div", { class: "corner" },
    ...(painted ? [toggle("Part colours", "one colour for each part", false, (on) => { partColours = on; })] : []),
    ...(data.camera ? [throughButton] : []),
    element("button", { type: "button", title: "back to the first view", onclick: () => {
      if (through) throughButton.click();
      orbit.home();
      redraw();
    } }, "Reset")));

  /* Parts as Gaussians or as surfaces. */
  const both = data.gaussians && data.surfaces.some((surface) => data.gaussians.layers.includes(surface.layer));
  const lookChoice = both && FreeArt.choice("how the parts are shown",
    [["gaussians", "Gaussians"], ["surfaces", "Surfaces"]], "gaussians", (chosen) => {
      gaussians = chosen === "gaussians";
      redraw();
    });
  if (lookChoice) legend.before(lookChoice);

  /* The legend, whose entries show and hide layers; layers of one name have one entry. */
  for (const text of new Set(data.layers.map((layer) => layer.name))) {
    const own = data.layers.flatMap((layer, i) => (layer.name === text ? [i] : []));
    if (!data.surfaces.some((surface) => own.includes(surface.layer)) && !own.some((i) => data.gaussians?.layers.includes(i))) continue;
    const { style, colour, shown: first } = data.layers[own[0]], mark = element("i", { class: style });
    mark.style.background = mark.style.borderColor = colour;
    const button = toggle(text, "show or hide", first, (on) => { for (const i of own) shown[i] = on; });
    button.prepend(mark);
    legend.append(button);
  }

  /* One slider a joint. */
  const rows = data.sliders.map((slider, k) => {
    const output = element("output", {});
    const range = element("input", { type: "range", min: slider.lower, max: slider.upper, step: "any",
      value: slider.value, "aria-label": `state of ${slider.name}` });
    const set = (q) => {
      values[k] = FreeArt.clamp(q, slider.lower, slider.upper);
      range.value = values[k];
      output.textContent = FreeArt.stateText(slider.type, values[k]);
      redraw();
    };
    const play = FreeArt.playButton(`move ${slider.name}`, (playing) => {
      if (!playing) return;
      row.unfollow();
      const middle = (slider.upper + slider.lower) / 2, half = (slider.upper - slider.lower) / 2 || 1;
      const phase = Math.asin(FreeArt.clamp((values[k] - middle) / half, -1, 1));
      let start = null;
      const tick = (now) => {
        if (!play.playing) return;
        start ??= now;
        set(middle + half * Math.sin(phase + (now - start) / 900));
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    });
    const follow = element("input", { type: "checkbox", checked: slider.states !== null });
    const row = { set, slider, follow,
      unfollow() { follow.checked = false; },
      free() {
        play.set(false);
        follow.checked = false;
      },
      track(frame) {
        if (slider.states && follow.checked) set(slider.states[FreeArt.clamp(frame, 0, slider.states.length - 1)]);
      } };
    range.addEventListener("input", () => {
      row.free();
      set(Number(range.value));
    });
    follow.addEventListener("change", () => {
      if (follow.checked) play.set(false);
      row.track(bus.frame);
    });
    sliders.append(element("div", { class: "slider" }, play, element("span", { class: "name", title: slider.name }, slider.name),
      range, output, ...(slider.states ? [element("label", {}, follow, "follow video")] : [])));
    set(slider.value);
    return row;
  });

  bus.on("frame", (frame) => {
    for (const row of rows) row.track(frame);
    redraw();
  });
  bus.on("link", (link) => {
    if (link.state && rows.length && Number.isFinite(Number(link.state))) {
      rows[0].free();
      rows[0].set(Number(link.state));
    }
    if (link.yaw || link.pitch) orbit.look(Number(link.yaw || 0), Number(link.pitch || 0));
    if (link.look) lookChoice && lookChoice.set(link.look);
    if (link.view === "video" && data.camera && !through) throughButton.click();
    if (link.show)
      for (const button of legend.children) {
        const on = link.show.split(",").some((word) => button.textContent.includes(word));
        if (on !== (button.getAttribute("aria-pressed") === "true")) button.click();
      }
    redraw();
  });
  orbit.home();
  let first = true;
  new ResizeObserver(() => {
    if (first) orbit.fit();
    first = false;
    redraw();
  }).observe(canvas);
};
