// A recording: every frame of an episode is kept, and one can go to any of them.

/** Whoever draws no picture for so long is not looked at, ms. */
const GONE = 3000;

export class Tape {
  pace = "episodes";
  speed = 1;
  paused = false;
  /** Simulated time of a step, s. */
  stepSeconds = 0.2;
  #frames = [];
  #at = -1;
  /** When the frame was shown that is shown, ms. */
  #since = 0;
  /** What is shown is where it is to be. */
  #rests = true;
  #show;
  #arrived;
  #rewound;
  #moved;

  /**
   * `show(frame, before, fraction)` draws, `arrived(frame)` takes note of the next frame, `rewound(frames)` of
   * all up to the one that is gone to, `moved(at, last)` of where that is.
   */
  constructor({ show, arrived, rewound, moved }) {
    this.#show = show;
    this.#arrived = arrived;
    this.#rewound = rewound;
    this.#moved = moved;
  }

  /** Something else is watched from now on. */
  clear() {
    this.#frames = [];
    this.#at = -1;
    this.#rests = true;
  }

  push(frame) {
    this.#frames.push(frame);
    this.#moved(this.#at, this.#last);
  }

  get #last() {
    return this.#frames.length - 1;
  }

  /** Whether its last frame is shown. */
  get isOver() {
    return this.#at >= 0 && this.#at === this.#last;
  }

  /** Goes to a frame, where there is any. */
  seek(at) {
    if (this.#last < 0) return;
    this.#at = Math.max(0, Math.min(this.#last, at));
    this.#since = -Infinity;
    this.#rests = true;
    this.#rewound(this.#frames.slice(0, this.#at + 1));
    this.#show(this.#frames[this.#at], null, 1);
    this.#moved(this.#at, this.#last);
  }

  /** Goes some frames on, or back. */
  move(frames) {
    this.seek(this.#at + frames);
  }

  /** Shows what is due at `now`, ms. */
  tick(now) {
    const glide = (1000 * this.stepSeconds) / this.speed;
    // A page that was hidden goes on where it was; one that draws slowly leaves pictures out.
    const waits = this.#rests && (this.paused || this.#at === this.#last);
    if (this.#at < 0 || waits || now - this.#since > GONE) this.#since = now - glide;
    while (!this.paused && this.#at < this.#last && now >= this.#since + glide) {
      this.#since += glide;
      this.#at += 1;
      this.#rests = false;
      this.#arrived(this.#frames[this.#at]);
      this.#moved(this.#at, this.#last);
    }
    if (!this.#rests) {
      const fraction = Math.min(1, (now - this.#since) / glide);
      this.#show(this.#frames[this.#at], this.#frames[this.#at - 1] ?? null, fraction);
      this.#rests = fraction === 1;
    }
  }
}
