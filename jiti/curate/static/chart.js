// Rewards and returns of one episode under its video, on the same frames.

const LEFT = 40;
const TOP = 14;

export class Chart {
  data = null; // { frame_count, reward, annotated, mc_return, segments }
  frame = 0;

  constructor(canvas, { onSeek }) {
    Object.assign(this, { canvas, onSeek });
    const seek = (event) => event.buttons && this.data && onSeek(this.#frameAt(event));
    canvas.addEventListener("pointerdown", seek);
    canvas.addEventListener("pointermove", seek);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  #x(frame) {
    return LEFT + (frame / this.data.frame_count) * (this.width - LEFT - 6);
  }

  #frameAt(event) {
    const x = event.clientX - this.canvas.getBoundingClientRect().left;
    return Math.max(0, Math.min(this.data.frame_count - 1, Math.floor(((x - LEFT) / (this.width - LEFT - 6)) * this.data.frame_count)));
  }

  draw() {
    const ratio = devicePixelRatio;
    this.width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    if (!this.width || !height) return;
    this.canvas.width = this.width * ratio;
    this.canvas.height = height * ratio;
    const g = this.canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (!this.data) return;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`);
    const bottom = height - 18;
    const top = Math.max(1e-9, ...this.data.mc_return);
    const y = (value) => bottom - (value / top) * (bottom - TOP);
    g.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    // Accepted segments as areas, the narrower over the wider; proposals, which give no reward, as a thin line on top.
    const wide = this.data.segments.filter((s) => s.status !== "rejected").toSorted((a, b) => b.end_frame - b.start_frame - a.end_frame + a.start_frame);
    for (const segment of wide) {
      const x = this.#x(segment.start_frame);
      const width = this.#x(segment.end_frame + 1) - x;
      const accepted = segment.status === "accepted";
      g.fillStyle = colour(accepted ? { 1: "pass-soft", 0: "fail-soft", null: "open-soft" }[segment.reward] : "ghost");
      g.fillRect(x, TOP, width, accepted ? bottom - TOP : 2);
    }
    g.fillStyle = colour("quiet");
    g.fillText(top.toPrecision(3), 2, TOP + 4);
    g.fillText("0", 2, bottom + 3);
    g.fillRect(LEFT, bottom, this.width - LEFT - 6, 1);
    this.data.reward.forEach((reward, frame) => {
      if (!this.data.annotated[frame]) return;
      g.fillStyle = colour(reward ? "pass" : "fail");
      g.fillRect(this.#x(frame), bottom + 3, Math.max(1, this.#x(frame + 1) - this.#x(frame)), 7);
    });
    g.strokeStyle = colour("accent");
    g.lineWidth = 1.6;
    g.beginPath();
    this.data.mc_return.forEach((value, frame) => g[frame ? "lineTo" : "moveTo"](this.#x(frame + 0.5), y(value)));
    g.stroke();
    g.fillStyle = colour("playhead");
    g.fillRect(this.#x(this.frame + 0.5) - 0.75, TOP - 6, 1.5, bottom - TOP + 18);
    g.fillStyle = colour("text");
    const label = `frame ${this.frame}  return ${(this.data.mc_return[this.frame] ?? 0).toFixed(3)}`;
    g.fillText(label, Math.min(this.width - g.measureText(label).width - 8, Math.max(LEFT, this.#x(this.frame) + 5)), 9);
  }
}
