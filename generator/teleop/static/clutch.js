// Geometry of carrying an object with a controller, and of moving its joint by a stick. No page, no headset.
//
// Poses are {position: [x, y, z] m, quaternion: [w, x, y, z]}. A room's axes are WebXR's (x right, y up, z back), a
// camera's are x right, y down, z forward.

import { add, clamp, conjugate, minus, multiply, normalised, rotate } from "./hand.js";

const HALF_TURN_ABOUT_X = [0, 1, 0, 0]; // up becomes down, back becomes forward
const STEEP = 0.3;

/** The heading of a head: a horizontal unit vector [x, 0, z] in the room's axes. */
export function heading(headQuaternion) {
  let ahead = rotate(headQuaternion, [0, 0, -1]);
  if (Math.hypot(ahead[0], ahead[2]) < STEEP) {
    // when looking at the floor or the ceiling, the top of the head gives the heading
    const top = rotate(headQuaternion, [0, 1, 0]);
    ahead = ahead[1] < 0 ? top : top.map((c) => -c);
  }
  const length = Math.hypot(ahead[0], ahead[2]);
  return [ahead[0] / length, 0, ahead[2] / length];
}

/** The rotation about the upright axis that takes (0, 0, -1) to `ahead` (`heading`). */
export function facing(ahead) {
  const yaw = Math.atan2(-ahead[0], -ahead[2]);
  return [Math.cos(yaw / 2), 0, Math.sin(yaw / 2), 0];
}

/**
 * The rotation from the room's axes to the camera's for a person who faces `ahead`: right, up and away of the person are
 * right, up and away in the camera's picture.
 */
export function roomToCamera(ahead) {
  return multiply(HALF_TURN_ABOUT_X, conjugate(facing(ahead)));
}

/**
 * A controller that carries the object while it is squeezed. The object moves and rotates about `pivot` as the controller
 * has since the grasp: nothing jumps when a grasp begins or ends, and several grasps add up.
 */
export class Clutch {
  /** @param pivot Centre of rotation in the object's frame, m. */
  constructor(pivot = [0, 0, 0]) {
    this.pivot = pivot;
    this.release();
  }

  get holds() {
    return this.begun !== null;
  }

  /**
   * Start a grasp.
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

  /** The object's pose for the controller's; translations have scale 1. */
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
 * Dead zone of a stick: XInput's XINPUT_GAMEPAD_LEFT_THUMB_DEADZONE, 7849 of 32767.
 */
export const STICK_REST = 0.24;
/**
 * Joint speed, ranges a second, at full deflection of a stick. In 23 takes of ARCTIC with a moving joint, nine tenths of
 * its motion are slower than 2.1; half is slower than .76, the speed at 70 % deflection.
 */
export const STICK_SPEED = 2;
/** A stick's deflection in -1 to 1 beyond the dead zone, squared for fine control near the middle. */
export function response(deflection) {
  const beyond = Math.max(Math.abs(deflection) - STICK_REST, 0) / (1 - STICK_REST);
  return Math.sign(deflection) * Math.min(beyond, 1) ** 2;
}

/**
 * The joint state after `dt` seconds: pushed away, the stick increases it, pulled near it decreases it.
 * @param state Now, rad or m.
 * @param stick Deflection towards the person, -1 to 1, as gamepads have it.
 * @param limits Lowest and highest state.
 */
export function swung(state, stick, [low, high], dt) {
  return clamp(state - response(stick) * STICK_SPEED * (high - low) * dt, low, high);
}

/** A button: `step` returns "press" when it goes down, then "short" on release or "long" after `longest` seconds. */
export class Button {
  /** @param longest Seconds after which a press is long. */
  constructor(longest = Infinity) {
    this.longest = longest;
    this.drop();
  }

  /** Ignore the button until it is released. */
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
