// Hands on: keys and a gamepad drive an arm of a live world. Only a page whose address has the server's token may.

/** How often motions are sent: each acts for a tenth of a second, so an arm stops soon after the last. */
const PERIOD_MS = 33;
/** Speeds of full deflection: m/s, rad/s. */
const SPEED = 0.03, TURN = 1.0;
/** What of a stick counts as none. */
const IDLE = 0.15;
/** Angles of the jaw, rad: open, and squeezing; and how long it may take from one to the other, where life is at its own
 * pace. Arm and jaw have one trajectory, so the arm waits for the jaw. */
const OPEN = 0.7, CLOSED = -0.35, JAW_MS = 700;

/** Right, away from the viewer, up; turns about the same axes. */
const KEYS = {
  a: [-1, 0, 0, 0, 0, 0], d: [1, 0, 0, 0, 0, 0],
  s: [0, -1, 0, 0, 0, 0], w: [0, 1, 0, 0, 0, 0],
  f: [0, 0, -1, 0, 0, 0], r: [0, 0, 1, 0, 0, 0],
  i: [0, 0, 0, -1, 0, 0], k: [0, 0, 0, 1, 0, 0],
  j: [0, 0, 0, 0, -1, 0], l: [0, 0, 0, 0, 1, 0],
  q: [0, 0, 0, 0, 0, 1], e: [0, 0, 0, 0, 0, -1],
};

export class Drive {
  #send;
  #heading;
  #token;
  #held = new Set();
  #timer = null;
  #session = null;
  #arms = [];
  #arm = 0;
  #isOpen = false;
  #wasPressed = new Set();
  #moves = false;
  #speed = 1;
  #waitsUntil = 0;
  onChange = () => {};

  /** `heading` gives the direction in which the viewer looks, rad about the vertical. */
  constructor(send, heading) {
    [this.#send, this.#heading] = [send, heading];
    this.#token = new URLSearchParams(location.hash.slice(1)).get("token");
  }

  get token() {
    return this.#token;
  }

  get isOn() {
    return this.#timer !== null;
  }

  get arm() {
    return this.#arms[this.#arm];
  }

  /** Whether this page may drive arms of a session. */
  offers(card) {
    return Boolean(this.#token && card?.arms?.length);
  }

  /** Begins to drive the arms of a session, the first one at first. */
  start(card) {
    [this.#session, this.#arms, this.#arm] = [card.id, card.arms, 0];
    this.#speed = card.speed || 1;
    this.#held.clear();
    this.#timer = setInterval(() => this.#tick(), PERIOD_MS);
    this.#do("enable");
    this.onChange();
  }

  stop() {
    if (!this.isOn) return;
    clearInterval(this.#timer);
    this.#timer = null;
    this.#send("let_go");
    this.onChange();
  }

  /** Takes a key, if it drives; whether it does. */
  key(event, isDown) {
    const key = event.key.toLowerCase();
    if (key in KEYS) {
      if (isDown) this.#held.add(key);
      else this.#held.delete(key);
      return true;
    }
    if (key === " ") {
      if (isDown && !event.repeat) this.#grip();
      return true;
    }
    if (key === "tab") {
      if (isDown && !event.repeat) this.#other();
      return true;
    }
    return false;
  }

  /** Nothing is held any more, as far as this page can know. */
  release() {
    this.#held.clear();
  }

  #grip() {
    this.#isOpen = !this.#isOpen;
    this.#do({ jaw: this.#isOpen ? OPEN : CLOSED });
    this.#waitsUntil = performance.now() + JAW_MS / this.#speed;
  }

  #other() {
    this.#do("hold");
    this.#arm = (this.#arm + 1) % this.#arms.length;
    this.#do("enable");
    this.onChange();
  }

  #tick() {
    const sum = [0, 0, 0, 0, 0, 0];
    for (const key of this.#held) KEYS[key].forEach((part, axis) => (sum[axis] += part));
    this.#gamepad(sum);
    if (performance.now() < this.#waitsUntil) {
      this.#moves = false;
      return;
    }
    const moves = sum.some((part) => part !== 0);
    if (moves) {
      const [right, away, up, ...turns] = sum.map((part) => Math.max(-1, Math.min(1, part)));
      this.#do({ twist: [...this.#inWorld(right, away, up, SPEED), ...this.#inWorld(...turns, TURN)] });
    } else if (this.#moves) {
      this.#do("hold");
    }
    this.#moves = moves;
  }

  /** Adds what a gamepad's sticks say: left right and away, right turns; shoulder buttons up and down; A the jaw. */
  #gamepad(sum) {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((each) => each?.mapping === "standard");
    if (!pad) return;
    const stick = (axis) => (Math.abs(pad.axes[axis]) < IDLE ? 0 : pad.axes[axis]);
    const pressed = (button) => pad.buttons[button]?.value ?? 0;
    [stick(0), -stick(1), pressed(7) - pressed(6), stick(3), stick(2), pressed(4) - pressed(5)].forEach(
      (part, axis) => (sum[axis] += part),
    );
    for (const [button, act] of [[0, () => this.#grip()], [3, () => this.#other()]]) {
      const isPressed = pressed(button) > 0.5;
      if (isPressed && !this.#wasPressed.has(button)) act();
      if (isPressed) this.#wasPressed.add(button);
      else this.#wasPressed.delete(button);
    }
  }

  /** A vector in the viewer's axes in those of the world. */
  #inWorld(right, away, up, scale) {
    const heading = this.#heading();
    const [x, y] = [Math.cos(heading), Math.sin(heading)];
    return [scale * (away * x + right * y), scale * (away * y - right * x), scale * up];
  }

  #do(motion) {
    this.#send({ drive: { session: this.#session, token: this.#token, arm: this.arm, motion } });
  }
}
