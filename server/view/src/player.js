// When frames are shown: the present at once, or an episode's steps at the speed of life.

/** Longest time in which the present moves to where it is, ms. */
const GLIDE = 120;
/** How long the end of an episode stays, ms. */
const REST = 700;
/** So many frames are left when the next episode is asked for. */
const AHEAD = 20;
/** Whoever is later than that does not catch up, ms. */
const LATE = 100;
/** Steps between two frames from which on there is no way from one to the other. */
const FAR = 4;

export class Player {
  pace = "live";
  speed = 1;
  paused = false;
  /** Simulated time of a step, s. */
  stepSeconds = 0.2;
  #frames = [];
  #shown = null;
  #before = null;
  #since = 0;
  #glide = 0;
  #span = 0;
  #asked = true;
  /** What is shown is where it is to be. */
  #rests = true;
  #show;
  #arrived;
  #more;

  /** `show(frame, before, fraction)` draws, `arrived(frame)` takes note of a frame, `more()` asks for an episode. */
  constructor({ show, arrived, more }) {
    this.#show = show;
    this.#arrived = arrived;
    this.#more = more;
  }

  /** Something else is watched from now on. */
  clear() {
    this.#frames = [];
    this.#shown = this.#before = null;
    this.#rests = true;
    this.#asked = true; // to watch is to ask
  }

  push(frame) {
    if (this.pace === "live") {
      // Pictures may be left out, steps may not.
      const marks = this.#frames.flatMap((missed) => missed.marks);
      frame.marks.unshift(...marks);
      this.#frames = [];
    }
    this.#frames.push(frame);
    if (frame.marks.some((mark) => mark.ended)) this.#asked = false;
  }

  /** Shows what is due at `now`, ms. */
  tick(now) {
    if (this.paused) return;
    while (this.#frames.length > 0 && now >= this.#since + this.#span) this.#advance(now);
    if (!this.#rests) {
      const fraction = this.#glide > 0 ? Math.min(1, (now - this.#since) / this.#glide) : 1;
      this.#show(this.#shown, this.#before, fraction);
      this.#rests = fraction === 1;
    }
    if (this.pace === "episodes" && !this.#asked && this.#frames.length < AHEAD) {
      this.#asked = true;
      this.#more();
    }
  }

  #advance(now) {
    const next = this.#frames.shift(), shown = this.#shown;
    const follows = shown && next.episode === shown.episode && next.seed === shown.seed &&
      next.steps >= shown.steps && next.steps - shown.steps < FAR;
    const due = this.#since + this.#span;
    if (this.pace === "episodes") {
      this.#glide = (1000 * this.stepSeconds) / this.speed;
      this.#span = this.#glide + (next.marks.some((mark) => mark.ended) ? REST : 0);
      this.#since = now - due < LATE ? due : now;
    } else {
      this.#glide = this.#span = Math.min(GLIDE, now - this.#since);
      this.#since = now;
    }
    this.#before = follows ? shown : null;
    this.#shown = next;
    this.#rests = false;
    this.#arrived(next);
  }
}
