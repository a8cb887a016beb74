// The dataset at a glance: one row an episode, time from left (start) to right (end), rewards and returns side by side.

const GAP = 8;
const COLOURS = ["raised", "fail", "pass"]; // states 0, 1, 2

// Viridis at five points, dark to light: returns from 0 to the largest.
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

export class RewardMap {
  view = [0, 1];
  data = { count: 0, bins: 1, states: new Uint8Array(), returns: new Uint8Array(), order: [] };
  chosen = null;

  constructor(canvas, { onChoose, onHover }) {
    Object.assign(this, { canvas, onChoose, onHover });
    canvas.addEventListener("click", (event) => this.#at(event, onChoose));
    canvas.addEventListener("pointermove", (event) => this.#at(event, onHover));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("dblclick", () => this.fit());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  show(data) {
    const same = data.order.length === this.data.order.length;
    this.data = data;
    if (!same) this.view = [0, data.order.length];
    this.draw();
  }

  fit() {
    this.view = [0, this.data.order.length];
    this.draw();
  }

  draw() {
    const { bins, states, returns, order } = this.data;
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    if (!width || !height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    const g = this.canvas.getContext("2d");
    if (!order.length) return;
    const half = Math.floor((width - GAP) / 2);
    const picture = g.createImageData(width, height);
    const style = getComputedStyle(document.documentElement);
    const palette = COLOURS.map((name) => rgb(style.getPropertyValue(`--${name}`)));
    const [from, to] = this.view;
    const perPixel = (to - from) / height;
    for (let y = 0; y < height; y++) {
      const first = Math.floor(from + y * perPixel);
      const last = Math.max(first + 1, Math.min(order.length, Math.floor(from + (y + 1) * perPixel)));
      const edge = perPixel < 1 / 6 && Math.floor(from + (y + 1) * perPixel) !== first;
      for (let x = 0; x < half; x++) {
        const bin = Math.floor((x / half) * bins);
        let state = 0;
        let best = 0;
        for (let row = first; row < last; row++) {
          const at = order[row] * bins + bin;
          // A failure among rows that share a pixel must stay in sight, then a pass.
          const seen = states[at];
          if (seen && (state === 0 || seen < state)) state = seen;
          if (returns[at] > best) best = returns[at];
        }
        paint(picture, x, y, width, edge ? palette[0] : palette[state]);
        paint(picture, half + GAP + x, y, width, edge ? palette[0] : ramp(best));
      }
    }
    g.putImageData(picture, 0, 0);
    const chosen = order.indexOf(this.chosen);
    if (chosen >= 0) {
      const y = (chosen - from) / perPixel;
      g.strokeStyle = style.getPropertyValue("--playhead");
      g.lineWidth = 2;
      g.strokeRect(1, y - 1, width - 2, Math.max(3, 1 / perPixel) + 2);
    }
  }

  #at(event, tell) {
    const { order } = this.data;
    const bounds = this.canvas.getBoundingClientRect();
    const row = Math.floor(this.view[0] + ((event.clientY - bounds.top) / bounds.height) * (this.view[1] - this.view[0]));
    if (row < 0 || row >= order.length) return;
    const half = (bounds.width - GAP) / 2;
    const x = event.clientX - bounds.left;
    tell(order[row], Math.max(0, Math.min(1, (x > half ? x - half - GAP : x) / half)));
  }

  #wheel(event) {
    event.preventDefault();
    const count = this.data.order.length;
    const [from, to] = this.view;
    const span = to - from;
    if (event.shiftKey) {
      const start = Math.max(0, Math.min(count - span, from + Math.sign(event.deltaY || event.deltaX) * span * 0.2));
      this.view = [start, start + span];
    } else {
      const bounds = this.canvas.getBoundingClientRect();
      const share = (event.clientY - bounds.top) / bounds.height;
      const wanted = Math.max(Math.min(8, count), Math.min(count, span * (event.deltaY > 0 ? 1.3 : 0.77)));
      const start = Math.max(0, Math.min(count - wanted, from + share * span - share * wanted));
      this.view = [start, start + wanted];
    }
    this.draw();
  }
}

function paint(picture, x, y, width, [r, g, b]) {
  const at = (y * width + x) * 4;
  picture.data[at] = r;
  picture.data[at + 1] = g;
  picture.data[at + 2] = b;
  picture.data[at + 3] = 255;
}

export function ramp(value) {
  const at = (value / 255) * (RAMP.length - 1);
  const k = Math.min(RAMP.length - 2, Math.floor(at));
  return RAMP[k].map((low, channel) => low + (RAMP[k + 1][channel] - low) * (at - k));
}

export function rgb(hex) {
  const value = parseInt(hex.trim().slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}
