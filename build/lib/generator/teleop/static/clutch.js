// The maths of carrying an object by a controller, and of moving its joint by a stick or a trigger. No page, no headset.
//
// Poses are {position: [x, y, z] m, quaternion: [w, x, y, z]}. A room's axes are WebXR's (x right, y up, z back), a
// camera's are x right, y down, z forward.

import { add, clamp, conjugate, minus, multiply, normalised, rotate } from "./hand.js";

const HALF_TURN_ABOUT_X = [0, 1, 0, 0]; // up becomes down, back becomes forward
const STEEP = 0.3;

/** Which way a head faces: the horizontal unit vector [x, 0, z] in the room's axes. */
export function heading(headQuaternion) {
  let ahead = rotate(headQuaternion, [0, 0, -1]);
  if (Math.hypot(ahead[0], ahead[2]) < STEEP) {
    // looking at the floor or the ceiling, the top of the head tells more
    const top = rotate(headQuaternion, [0, 1, 0]);
    ahead = ahead[1] < 0 ? top : top.map((c) => -c);
  }
  const length = Math.hypot(ahead[0], ahead[2]);
  return [ahead[0] / length, 0, ahead[2] / length];
}

/** The turn about the upright axis that brings "ahead" (0, 0, -1) to `ahead` (`heading`). */
export function facing(ahead) {
  const yaw = Math.atan2(-ahead[0], -ahead[2]);
  return [Math.cos(yaw / 2), 0, Math.sin(yaw / 2), 0];
}

/**
 * The turn that maps a room's vectors to the camera's for a person who faces `ahead`: the person's right is right in the
 * camera's picture, up is up, and away is away.
 */
export function roomToCamera(ahead) {
  return multiply(HALF_TURN_ABOUT_X, conjugate(facing(ahead)));
}

/**
 * A controller that carries the object while it is squeezed. The object goes and turns as the controller has since the
 * grasp, as if it were held at `pivot`: nothing jumps when a grasp begins or ends, and several grasps add up.
 */
export class Clutch {
  /** @param pivot Point of the object's frame, m, about which it turns: its centre. */
  constructor(pivot = [0, 0, 0]) {
    this.pivot = pivot;
    this.release();
  }

  get holds() {
    return this.begun !== null;
  }

  /**
   * Begin to carry.
   * @param object The object's pose in the camera's axes, now.
   * @param controller The controller's pose in the room, now.
   * @param toCamera `roomToCamera`.
   */
  grasp(object, controller, toCamera) {
    const lever = rotate(object.quaternion, this.pivot);
    this.begun = {
      centre: add(object.position, lever),
      turn: [...object.quaternion],
      at: [...controller.position],
      back: conjugate(controller.quaternion),
      toCamera,
    };
  }

  release() {
    this.begun = null;
  }

  /** The object's pose for the controller's: metre for metre, as objects are seen at arm's length. */
  carried(controller) {
    const { centre, turn, at, back, toCamera } = this.begun;
    const way = rotate(toCamera, minus(controller.position, at));
    const inRoom = multiply(controller.quaternion, back);
    const inCamera = multiply(multiply(toCamera, inRoom), conjugate(toCamera));
    const quaternion = normalised(multiply(inCamera, turn));
    const lever = rotate(quaternion, this.pivot);
    return { position: add(centre, minus(way, lever)), quaternion };
  }
}

/**
 * How far a stick may stand from its middle and mean nothing: XInput's XINPUT_GAMEPAD_LEFT_THUMB_DEADZONE, 7849 of 32767.
 */
export const STICK_REST = 0.24;
/** How far a trigger may be pulled and mean nothing: XInput's XINPUT_GAMEPAD_TRIGGER_THRESHOLD, 30 of 255. */
export const TRIGGER_REST = 0.12;
/**
 * Ranges of the joint a second, at a stick's end. In 23 takes of ARCTIC in which a joint moves, nine tenths of its motion
 * is slower than 2.1; half is slower than .76, which is where a stick is 70 % out.
 */
export const STICK_SPEED = 2;
/** The most that a trigger moves the joint by, in ranges a second: 99 % of that motion is slower than 3.9. */
export const TRIGGER_SPEED = 4;

/** A stick's deflection in -1 to 1 without its rest, squared, so that it is fine near the middle. */
export function response(deflection) {
  const beyond = Math.max(Math.abs(deflection) - STICK_REST, 0) / (1 - STICK_REST);
  return Math.sign(deflection) * Math.min(beyond, 1) ** 2;
}

/**
 * One controller's say on the joint's state.
 *
 * The stick is a speed: pushed away the state grows, pulled near it falls. The trigger is a place, as with a pair of
 * pliers: as far as it is pulled, so far the joint goes from where it was to the end that is farther away, and back when
 * the finger lets go.
 */
export class JointGrip {
  constructor() {
    this.drop();
  }

  /** Mean nothing until the trigger was let go: after the controller was lost, or carried, or something else moved the joint. */
  drop() {
    this.ready = false;
    this.from = null;
  }

  /**
   * The state after `dt` seconds.
   * @param state Now, rad or m.
   * @param stick Deflection towards the person, -1 to 1, as gamepads have it.
   * @param trigger 0 to 1.
   * @param limits Lowest and highest state.
   */
  moved(state, stick, trigger, limits, dt) {
    const [low, high] = limits;
    const range = high - low;
    const pull = Math.max(trigger - TRIGGER_REST, 0) / (1 - TRIGGER_REST);
    if (pull === 0) this.ready = true;
    if (pull > 0 && this.ready && this.from === null) {
      this.from = state;
      this.to = state - low > high - state ? low : high;
    }
    let next = state - response(stick) * STICK_SPEED * range * dt;
    if (this.from !== null) {
      const wanted = this.from + pull * (this.to - this.from);
      const most = TRIGGER_SPEED * range * dt;
      next = state + clamp(wanted - state, -most, most);
      if (pull === 0 && next === wanted) this.from = null; // back where it was
    }
    return clamp(next, low, high);
  }
}

/** A button: `step` says "press" when it goes down; then "short" when it is let go, or "long" once it was held so long. */
export class Button {
  /** @param longest Seconds after which it is held. */
  constructor(longest = Infinity) {
    this.longest = longest;
    this.drop();
  }

  /** Mean nothing until it was let go. */
  drop() {
    this.since = null;
    this.spent = true;
  }

  step(pressed, now) {
    if (!pressed) {
      const short = this.since !== null && !this.spent;
      this.since = null;
      this.spent = false;
      return short ? "short" : null;
    }
    if (this.spent) return null;
    if (this.since === null) {
      this.since = now;
      return "press";
    }
    if (now - this.since < this.longest) return null;
    this.spent = true;
    return "long";
  }
}
