// Control by a headset: reads WebXR controllers, sets the commanded pose and joint state.
//
// The controller that is squeezed first carries the object; the other's stick moves the joint. Only indices of the
// "xr-standard" mapping are used (squeeze 1, stick 3 and axes 2 and 3, buttons 4 and 5), which PICO's and Quest's controllers share.

import { Button, Clutch, facing, heading, roomToCamera, swung } from "./clutch.js";
import { Room } from "./room.js";

const SQUEEZED = 0.5; // from here on a squeeze holds ...
const LET_GO = 0.3; // ... until it is less than this, so that a hand that trembles does not let go. Not measured.
const SAVE_S = 1; // how long the record button is held to save. Not measured.
const LONGEST_STEP_S = 0.1; // a stick moves the joint by no more than it does in this time, however late a frame comes
const COLOURS = { holds: [76, 163, 255], tracked: [191, 199, 209] };
const HELP = [
  "Squeeze to carry the object. The other hand's stick moves the joint.",
  "A or X: record or pause, held: save.  B or Y: undo.  Stick pressed: recentre.",
];
const WATCHES = ["Another page drives.", "You watch."];
const ALONE = ["The connection is lost.", "It is tried again and again; a recording is paused."];
const LOST = ["The controller was out of sight.", "Squeeze again to carry on."];

/**
 * Show `button` where a headset is available, and start a session when it is pressed.
 * @param hand The commanded pose and state (hand.js).
 * @param link The connection (link.js).
 * @param picture The canvas with the camera's newest picture; no new one arrives while nothing moves.
 * @param button An element that is hidden.
 * @returns The state: {session: Headset or null}.
 */
export async function startHeadset({ hand, link, picture, button }) {
  const now = { session: null };
  const label = button.querySelector("span") ?? button;
  const say = (text) => (label.textContent = text);
  if (!window.isSecureContext) {
    button.hidden = false;
    button.disabled = true;
    say("Headset needs https");
    button.title =
      "Browsers give headsets to pages of https alone, or of this machine itself: start the server with --cert and " +
      "--key, or connect the headset by cable (adb reverse).";
    return now;
  }
  const offers = () => navigator.xr?.isSessionSupported("immersive-vr").catch(() => false) ?? false;
  const look = async () => {
    button.hidden = !(await offers());
  };
  navigator.xr?.addEventListener?.("devicechange", look);
  link.on("picture", (bitmap) => now.session?.room.show(bitmap));
  await look();
  const words = label.textContent;
  button.addEventListener("click", async () => {
    if (now.session) {
      await now.session.session.end();
      return;
    }
    button.disabled = true;
    try {
      now.session = await Headset.begin(hand, link, () => {
        now.session = null;
        link.immersive = false;
        say(words);
      });
      link.immersive = true;
      hand.device = "headset"; // of what is sent before anything moves, too
      link.send(hand, hand.device);
      now.session.room.show(picture);
      say("Leave headset");
    } catch (error) {
      say("No headset answered");
      button.title = error.message;
    } finally {
      button.disabled = false;
    }
  });
  return now;
}

/** One session. */
export class Headset {
  static async begin(hand, link, ended) {
    const session = await navigator.xr.requestSession("immersive-vr");
    try {
      const canvas = document.createElement("canvas");
      const gl = canvas.getContext("webgl2", { xrCompatible: true, antialias: false });
      if (!gl) throw new Error("this browser has no WebGL2");
      await gl.makeXRCompatible();
      const layer = new XRWebGLLayer(session, gl);
      await session.updateRenderState({ baseLayer: layer, depthNear: 0.05, depthFar: 50 });
      const space = await session.requestReferenceSpace("local");
      return new Headset({ session, space, gl, layer, hand, link, ended });
    } catch (error) {
      await session.end().catch(() => {});
      throw error;
    }
  }

  constructor({ session, space, gl, layer, hand, link, ended }) {
    Object.assign(this, { session, space, layer, hand, link });
    this.room = new Room(gl);
    this.colours = { holds: this.room.colour(COLOURS.holds), tracked: this.room.colour(COLOURS.tracked) };
    this.clutch = new Clutch();
    this.holder = null; // "left" or "right", while it carries
    this.controllers = { left: new Controller(), right: new Controller() };
    this.toCamera = null;
    this.before = null; // ms, of the last frame
    this.hint = HELP;
    this.told = 0;
    this.left = null; // where the hand had the object after the last frame
    space.addEventListener("reset", () => {
      this.letGo(); // the room's coordinates have jumped
      this.toCamera = null;
    });
    session.addEventListener("visibilitychange", () => this.looked());
    session.addEventListener("end", () => {
      this.rest();
      gl.getExtension("WEBGL_lose_context")?.loseContext(); // a page may have few of them
      ended();
    });
    session.requestAnimationFrame((time, frame) => this.step(time, frame));
  }

  /** The headset's menu is open, or it was taken off: nothing moves, and nothing is recorded. */
  looked() {
    if (this.session.visibilityState !== "visible") this.rest();
  }

  rest() {
    this.letGo();
    if (this.link.drives) this.link.do("pause"); // of no recording it is none
  }

  get status() {
    return this.link.status ?? {};
  }

  letGo() {
    this.clutch.release();
    this.holder = null;
    for (const one of Object.values(this.controllers)) one.drop();
  }

  step(time, frame) {
    this.session.requestAnimationFrame((next, nextFrame) => this.step(next, nextFrame));
    const dt = this.before === null ? 0 : Math.min((time - this.before) / 1000, LONGEST_STEP_S);
    this.before = time;
    const viewer = frame.getViewerPose(this.space);
    if (!viewer) return;
    if (!this.toCamera) this.recentre(viewer.transform);
    this.read(frame);
    if (this.session.visibilityState === "visible" && this.link.drives) {
      this.press(time / 1000, viewer.transform);
      this.move(dt, time);
    } else {
      this.letGo();
    }
    this.show(time, viewer.views);
  }

  /** Place the panel in front of the head, and align the axes with the head's heading. */
  recentre({ position, orientation }) {
    const ahead = heading([orientation.w, orientation.x, orientation.y, orientation.z]);
    this.toCamera = roomToCamera(ahead);
    this.room.hang([position.x, position.y, position.z], facing(ahead));
    if (this.holder) this.grasp(this.holder);
  }

  /** Evaluate both controllers in this frame. */
  read(frame) {
    const sources = [...this.session.inputSources].filter(
      (source) => source.gamepad?.mapping === "xr-standard" && !source.hand,
    );
    for (const [side, one] of Object.entries(this.controllers)) {
      const source = sources.find((candidate) => candidate.handedness === side);
      const space = source?.gripSpace ?? source?.targetRaySpace;
      const found = space && frame.getPose(space, this.space);
      one.read(source, found);
    }
  }

  press(now, head) {
    for (const one of Object.values(this.controllers)) {
      const record = one.record.step(one.pressed(4), now);
      if (record === "press") {
        one.pauses = this.status.recording; // at once: what comes while it is held is not of the take
        if (one.pauses) this.link.do("pause");
      }
      if (record === "short" && !one.pauses) this.link.do("record");
      if (record === "long") this.link.do("save");
      if (one.undo.step(one.pressed(5), now) === "press") this.link.do("undo");
      if (one.recentre.step(one.pressed(3), now) === "press") this.recentre(head);
    }
  }

  grasp(side) {
    this.clutch.pivot = this.hand.centre;
    this.clutch.grasp(this.hand, this.controllers[side].pose, this.toCamera);
    this.holder = side;
  }

  /** The carrying controller: the one squeezed first, until it is released or not tracked. */
  choose() {
    const { controllers } = this;
    if (this.holder && !controllers[this.holder].wants) {
      this.hint = controllers[this.holder].pose ? HELP : LOST;
      this.clutch.release();
      this.holder = null;
    }
    const wanting = Object.keys(controllers).find((side) => controllers[side].wants);
    if (this.holder || !wanting) return;
    this.hint = HELP;
    this.grasp(wanting);
    controllers[wanting].pulse();
  }

  /** The joint state from the controllers that do not carry, or from the only one. */
  bent(dt) {
    let { state } = this.hand;
    const tracked = Object.values(this.controllers).filter((one) => one.pose).length;
    for (const [side, one] of Object.entries(this.controllers)) {
      if (one.pose && (side !== this.holder || tracked === 1)) state = swung(state, one.stick, this.hand.limits, dt);
    }
    return state;
  }

  move(dt, time) {
    const { hand } = this;
    // an undo or another device has placed the object: continue from there
    if (this.holder && this.left && !same(this.left, hand)) this.grasp(this.holder);
    this.choose();
    const state = this.bent(dt);
    if (this.holder || state !== hand.state || this.status.recording) {
      const object = this.holder ? this.clutch.carried(this.controllers[this.holder].pose) : hand;
      hand.set(object.position, object.quaternion, state, "headset", time);
    }
    this.left = { position: hand.position, quaternion: hand.quaternion, state: hand.state };
  }

  show(time, views) {
    if (time - this.told > 100) {
      this.told = time;
      const { recording, paused, seconds } = this.status;
      const { state } = this.hand;
      const joint = this.link.hello?.joint_type;
      const notice = this.link.drives ? this.status.notice : null;
      const lines = this.link.drives ? this.hint : this.link.state === "open" ? WATCHES : ALONE;
      this.room.tell({ recording, paused, seconds, state, joint, notice, lines });
    }
    const shown = Object.entries(this.controllers)
      .filter(([, one]) => one.pose)
      .map(([side, one]) => ({ ...one.pose, colour: side === this.holder ? this.colours.holds : this.colours.tracked }));
    this.room.draw(this.layer, views, shown);
  }
}

/** The state of one controller. */
class Controller {
  constructor() {
    this.record = new Button(SAVE_S);
    this.undo = new Button();
    this.recentre = new Button();
    this.pose = null;
    this.located = false; // whether its position was ever a measured one
    this.drop();
  }

  /** Ignore all inputs until they are released. */
  drop() {
    this.wants = false; // to carry
    this.squeezed = true;
    for (const part of [this.record, this.undo, this.recentre]) part.drop();
  }

  /** @param found XRPose; null while the controller is not tracked. */
  read(source, found) {
    this.gamepad = source?.gamepad ?? null;
    // an emulated position jumps when the controller is tracked again; but some headsets have no other
    if (found && !found.emulatedPosition) this.located = true;
    if (!found || (found.emulatedPosition && this.located)) {
      if (this.pose) this.drop();
      this.pose = null;
      return;
    }
    const { position: p, orientation: q } = found.transform;
    this.pose = { position: [p.x, p.y, p.z], quaternion: [q.w, q.x, q.y, q.z] };
    const squeeze = this.value(1);
    if (squeeze < LET_GO) this.wants = this.squeezed = false;
    if (squeeze > SQUEEZED && !this.squeezed) this.wants = this.squeezed = true;
  }

  value(index) {
    return this.gamepad?.buttons[index]?.value ?? 0;
  }

  pressed(index) {
    return this.pose !== null && (this.gamepad?.buttons[index]?.pressed ?? false);
  }

  /** Stick deflection towards the person. */
  get stick() {
    return this.gamepad?.axes[3] ?? 0;
  }

  /** A short haptic pulse. */
  pulse() {
    this.gamepad?.hapticActuators?.[0]?.pulse?.(0.4, 25)?.catch?.(() => {});
  }
}

function same(a, b) {
  return a.state === b.state && ["position", "quaternion"].every((key) => a[key].every((c, k) => c === b[key][k]));
}
