// The reward of the latest steps as a curve.

const MOST = 4000;
/** Steps that the chart shows at least. */
const LEAST = 50;

export class Chart {
  #canvas;
  #marks = [];
  #dirty = true;
  /** Sum of the rewards since the episode began, as far as it was watched. */
  total = 0;

  constructor(canvas) {
    this.#canvas = canvas;
    new ResizeObserver(() => (this.#dirty = true)).observe(canvas);
  }

  clear() {
    this.#marks = [];
    this.total = 0;
    this.#dirty = true;
  }

  add(mark) {
    const last = this.#marks.at(-1);
    if (!mark.isStep || last?.ended) this.total = 0;
    if (mark.isStep) {
      this.total += mark.reward;
      this.#marks.push(mark);
    } else if (last) {
      last.ended = true;
    }
    if (this.#marks.length > MOST) this.#marks.splice(0, MOST / 4);
    this.#dirty = true;
  }

  /** Draws the latest `span` steps where something has changed. */
  draw(span) {
    if (!this.#dirty) return;
    this.#dirty = false;
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width === 0 || height === 0) return;
    const ratio = Math.min(devicePixelRatio, 2);
    this.#canvas.width = width * ratio;
    this.#canvas.height = height * ratio;
    const pen = this.#canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const shown = Math.max(LEAST, span);
    const marks = this.#marks.slice(-shown);
    let low = Infinity, high = -Infinity;
    for (const { reward } of marks) {
      if (reward < low) low = reward;
      if (reward > high) high = reward;
    }
    if (!(low <= high)) [low, high] = [-1, 0];
    if (high - low < 1e-9) [low, high] = low === 0 ? [-1, 0] : [Math.min(low, 0), Math.max(0, high)];
    const top = 8, bottom = height - 6, left = 44;
    const y = (reward) => bottom - ((reward - low) / (high - low)) * (bottom - top);
    const x = (index) => left + ((index + shown - marks.length) / (shown - 1)) * (width - left - 4);

    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = "#8d99a8";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.strokeStyle = "#ffffff12";
    for (const level of [high, low]) {
      pen.fillText(short(level), left - 8, y(level));
      line(pen, left, y(level), width, y(level));
    }
    marks.forEach(({ ended }, index) => {
      if (!ended) return;
      pen.strokeStyle = "#ffffff1f";
      line(pen, x(index), top - 4, x(index), bottom);
    });
    pen.strokeStyle = "#7fd1c7";
    pen.lineWidth = 1.6;
    pen.lineJoin = "round";
    pen.beginPath();
    marks.forEach(({ reward }, index) => {
      const begins = index === 0 || marks[index - 1].ended;
      if (begins) pen.moveTo(x(index), y(reward));
      else pen.lineTo(x(index), y(reward));
    });
    pen.stroke();
    marks.forEach(({ ended, success, reward }, index) => {
      if (!ended && index < marks.length - 1) return;
      pen.fillStyle = success ? "#86d993" : ended ? "#f07a7a" : "#7fd1c7";
      pen.beginPath();
      pen.arc(x(index), y(reward), 3, 0, 2 * Math.PI);
      pen.fill();
    });
  }
}

function line(pen, fromX, fromY, toX, toY) {
  pen.lineWidth = 1;
  pen.beginPath();
  pen.moveTo(fromX, Math.round(fromY) + 0.5);
  pen.lineTo(toX, Math.round(toY) + 0.5);
  pen.stroke();
}

/** A number in a few characters. */
export function short(number) {
  if (number === 0) return "0";
  const size = Math.abs(number);
  const digits = size >= 100 ? 0 : size >= 10 ? 1 : size >= 0.1 ? 2 : 3;
  return number.toFixed(digits).replace("-", "−");
}
