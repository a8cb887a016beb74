// The lanes: one row an ITC, segments and ghosts on it, events, marks and the playhead, drawn on a canvas.

export const RULER = 20;
export const EVENTS = 14;
export const LANE = 24;
const EDGE_PX = 6; // how near to an edge the pointer takes hold of it
const DRAG_PX = 3; // how far it must move before the edge does
const GLYPH = { 1: "✓", 0: "✗", null: "?" };
const TICKS = [1, 2, 5, 10, 25, 50, 100, 250, 500, 1000, 2500, 5000, 10000, 25000, 50000, 100000];

export class Timeline {
  view = [0, 1];

  // `model()` gives { last, lanes, segments, proposals, events, frame, mark, selected }.
  constructor(canvas, model, { onSeek, onSelect, onEdge }) {
    Object.assign(this, { canvas, model, onSeek, onSelect, onEdge });
    this.context = canvas.getContext("2d");
    this.drag = null;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => this.#up(event));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("dblclick", () => this.fit());
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
  }

  fit() {
    this.view = [0, this.model().last + 1];
    this.draw();
  }

  zoomTo(start, end) {
    const pad = Math.max(10, (end - start) * 1.5);
    this.view = [Math.max(0, start - pad), Math.min(this.model().last + 1, end + 1 + pad)];
    this.draw();
  }

  // Keeps the playhead in sight when zoomed in.
  follow(frame) {
    const [from, to] = this.view;
    if (frame >= from && frame < to) return;
    const span = to - from;
    const start = Math.max(0, Math.min(this.model().last + 1 - span, frame - span * 0.1));
    this.view = [start, start + span];
  }

  x(frame) {
    return ((frame - this.view[0]) / (this.view[1] - this.view[0])) * this.width;
  }

  frameAt(x) {
    return Math.floor(this.view[0] + (x / this.width) * (this.view[1] - this.view[0]));
  }

  draw() {
    const { lanes, segments, proposals, events, frame, mark, selected, last } = this.model();
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`);
    const ratio = devicePixelRatio;
    this.width = this.canvas.parentElement.clientWidth - document.getElementById("lane-names").offsetWidth;
    const height = RULER + EVENTS + lanes.length * LANE;
    if (this.width <= 0) return;
    this.canvas.width = this.width * ratio;
    this.canvas.height = height * ratio;
    this.canvas.style.height = `${height}px`;
    const g = this.context;
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, this.width, height);
    g.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    g.textBaseline = "middle";
    this.boxes = [];

    this.#ruler(g, colour, last);
    for (const event of events) {
      const x = this.x(event.frame + 0.5);
      g.fillStyle = colour(event.kind.startsWith("gripper") ? "accent" : "quiet");
      const size = event.kind.startsWith("gripper") ? 5 : 3;
      g.beginPath();
      g.moveTo(x - size, RULER + 2);
      g.lineTo(x + size, RULER + 2);
      g.lineTo(x, RULER + 2 + size * 1.8);
      g.fill();
    }
    lanes.forEach((lane, row) => {
      g.fillStyle = colour("line");
      g.fillRect(0, RULER + EVENTS + row * LANE, this.width, 1);
    });
    for (const proposal of proposals) this.#segment(g, colour, lanes, proposal, proposal.segment_id === selected, true);
    for (const segment of segments) this.#segment(g, colour, lanes, segment, segment.segment_id === selected, false);
    if (mark !== null) {
      g.fillStyle = colour("open");
      g.globalAlpha = 0.25;
      const [a, b] = [Math.min(mark, frame), Math.max(mark, frame) + 1];
      g.fillRect(this.x(a), RULER, this.x(b) - this.x(a), height);
      g.globalAlpha = 1;
      g.fillRect(this.x(mark) - 1, RULER, 2, height);
    }
    g.fillStyle = colour("playhead");
    g.globalAlpha = 0.18;
    g.fillRect(this.x(frame), 0, Math.max(1, this.x(frame + 1) - this.x(frame)), height);
    g.globalAlpha = 1;
    g.fillRect(this.x(frame + 0.5) - 0.75, 0, 1.5, height);
  }

  #ruler(g, colour, last) {
    const perFrame = this.width / (this.view[1] - this.view[0]);
    const step = TICKS.find((tick) => tick * perFrame > 58) ?? TICKS.at(-1);
    g.fillStyle = colour("quiet");
    for (let f = Math.ceil(this.view[0] / step) * step; f <= Math.min(last, this.view[1]); f += step) {
      const x = this.x(f + 0.5);
      g.fillRect(x, RULER - 5, 1, 5);
      const label = String(f);
      const width = g.measureText(label).width;
      g.fillText(label, Math.max(1, Math.min(this.width - width - 1, x - width / 2)), 8);
    }
  }

  #segment(g, colour, lanes, stored, chosen, ghost) {
    const dragged = this.drag?.moved && this.drag.segment.segment_id === stored.segment_id;
    const segment = dragged ? this.#moved(stored) : stored;
    const row = lanes.findIndex((lane) => lane.itc_id === segment.itc_id);
    if (row < 0) return;
    const kind = segment.status === "rejected" ? "quiet" : { 1: "pass", 0: "fail", null: "open" }[segment.reward];
    const x = this.x(segment.start_frame);
    const width = Math.max(3, this.x(segment.end_frame + 1) - x);
    const depth = this.boxes.filter((b) => b.row === row && b.x < x + width && x < b.x + b.width).length;
    const y = RULER + EVENTS + row * LANE + 3 + Math.min(depth, 3) * 3;
    const height = LANE - 6 - Math.min(depth, 3) * 3;
    this.boxes.push({ x, width, y, height, row, segment, ghost });
    g.save();
    g.beginPath();
    g.roundRect(x, y, width, height, 3);
    g.fillStyle = ghost ? colour("ghost-soft") : kind === "quiet" ? colour("raised") : colour(`${kind}-soft`);
    g.fill();
    g.lineWidth = chosen ? 2.5 : 1;
    g.strokeStyle = ghost ? colour("ghost") : colour(kind);
    if (ghost) g.setLineDash([4, 3]);
    g.stroke();
    g.clip();
    g.fillStyle = ghost ? colour("ghost") : colour(kind);
    const label = segment.status === "rejected" ? "–" : GLYPH[segment.reward];
    const sure = ghost && segment.confidence !== null ? ` ${Math.round(segment.confidence * 100)}%` : "";
    if (width > 9) g.fillText(label + (width > 44 ? sure : ""), x + 4, y + height / 2 + 0.5);
    g.restore();
  }

  #hit(event) {
    const { x, y } = this.#point(event);
    const box = this.boxes?.findLast((b) => x >= b.x - EDGE_PX && x <= b.x + b.width + EDGE_PX && y >= b.y && y <= b.y + b.height);
    if (!box) return null;
    const near = (edge) => Math.abs(x - edge) <= EDGE_PX && box.width > 3 * EDGE_PX;
    const edge = box.ghost ? null : near(box.x) ? "start_frame" : near(box.x + box.width) ? "end_frame" : null;
    return { ...box, edge };
  }

  #point(event) {
    const bounds = this.canvas.getBoundingClientRect();
    return { x: event.clientX - bounds.left, y: event.clientY - bounds.top };
  }

  #down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    const hit = this.#hit(event);
    if (hit) this.onSelect(hit.segment);
    // An edge moves only when it is dragged, by as much as the pointer: a click near it must not.
    const grabbed = hit?.edge && { edge: hit.edge, segment: hit.segment, from: event.clientX, moved: false };
    this.drag = grabbed || { seek: true };
    if (!hit?.edge) this.onSeek(this.frameAt(this.#point(event).x));
  }

  #move(event) {
    if (!this.drag) {
      const hit = this.#hit(event);
      this.canvas.style.cursor = hit?.edge ? "ew-resize" : "pointer";
      return;
    }
    if (this.drag.edge) {
      this.drag.moved ||= Math.abs(event.clientX - this.drag.from) >= DRAG_PX;
      if (this.drag.moved) this.onSeek((this.drag.to = this.#edgeFrame(event)));
    } else {
      this.onSeek(this.frameAt(this.#point(event).x));
    }
  }

  #edgeFrame(event) {
    const frames = ((event.clientX - this.drag.from) / this.width) * (this.view[1] - this.view[0]);
    return this.drag.segment[this.drag.edge] + Math.round(frames);
  }

  // A segment whose edge is being dragged, as it would be if it were let go now.
  #moved(segment) {
    const { edge, to } = this.drag;
    const other = segment[edge === "start_frame" ? "end_frame" : "start_frame"];
    return { ...segment, [edge]: edge === "start_frame" ? Math.min(Math.max(to, 0), other) : Math.max(Math.min(to, this.model().last), other) };
  }

  #up(event) {
    const drag = this.drag;
    if (drag?.moved && event.type === "pointerup") this.onEdge(drag.segment, drag.edge, this.#edgeFrame(event));
    this.drag = null;
  }

  #wheel(event) {
    event.preventDefault();
    const { last } = this.model();
    const [from, to] = this.view;
    const span = to - from;
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      const move = ((event.deltaX || event.deltaY) / this.width) * span;
      const start = Math.max(0, Math.min(last + 1 - span, from + move));
      this.view = [start, start + span];
    } else {
      const pivot = from + (this.#point(event).x / this.width) * span;
      const wanted = Math.max(Math.min(20, last + 1), Math.min(last + 1, span * (event.deltaY > 0 ? 1.25 : 0.8)));
      const start = Math.max(0, Math.min(last + 1 - wanted, pivot - ((pivot - from) / span) * wanted));
      this.view = [start, start + wanted];
    }
    this.draw();
  }
}
