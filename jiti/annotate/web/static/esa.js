// The Elegance Segment Annotator: one episode, its lanes and its keys. State lives here; parts are drawn from it.

import { call, episodePath, make, Refused, setTheme, text, theme } from "./api.js";
import { Clock, Player } from "./clock.js";
import { Inspector } from "./inspector.js";
import { Keys } from "./keys.js";
import { Labels } from "./labels.js";
import { Queue } from "./queue.js";
import { Timeline } from "./timeline.js";
import { Viewer } from "./viewer.js";

const WINDOW = 25; // frames of a segment marked with one key; the paper's window
const FAR = 10; // frames of a long step or nudge
const SNAP = 15; // frames within which an edge snaps to an event

setTheme(theme());
const $ = (id) => document.getElementById(id);

let episode = null;
let clock = new Clock([0]);
let frame = 0;
let lane = 0;
let selected = null;
let mark = null;
let looping = false;
let events = [];
let lastVersion = null;

// The task's ITCs, then those that someone labelled although the task does not have them (any more).
const lanes = () => {
  const own = episode?.task.itcs ?? [];
  const known = new Set(own.map((itc) => itc.itc_id));
  const others = [...labels.segments, ...labels.proposals].filter((s) => !known.has(s.itc_id));
  const extra = [...new Map(others.map((s) => [s.itc_id, { itc_id: s.itc_id, statement: "Not in the catalogue: pass --tasks FILE.", criterion: s.criterion, check: "" }])).values()];
  return [...own, ...extra];
};
const current = () => labels.segments.find((s) => s.segment_id === selected);

// ---- parts ----

const NO_LABELS = { segments: [], proposals: [], version: 0, can_undo: false, can_redo: false, label_problems: [] };

const labels = new Labels({
  onChange: draw,
  onSaving: () => saved("saving", "Saving…"),
  onSaved: (version) => saved("saved", `Saved · ${version}`),
  onTrouble(error) {
    const stale = error instanceof Refused && error.status === 409;
    saved("failed", stale ? "Not saved: changed elsewhere" : "Not saved");
    warn(stale ? `${error.message} The page shows the newest state now; do it again if it still applies.` : error.message);
  },
});
const viewer = new Viewer($("viewer"), theme(), {
  onSeek: (ns) => seek(clock.frameAt(ns + 1)),
  onOpen: () => (document.body.dataset.recording = episode?.recording_id ?? ""),
});
const player = new Player((ns) => show(clock.frameAt(ns)));
const timeline = new Timeline(
  $("lane-canvas"),
  () => ({ last: clock.last, lanes: lanes(), segments: labels.segments, proposals: labels.proposals, events, frame, mark, selected }),
  {
    onSeek: (f) => seek(f),
    onSelect: (segment) => select(segment.segment_id, false),
    onEdge: (segment, edge, f) => setEdge(segment.segment_id, edge, () => f),
  },
);
const inspector = new Inspector($("segments"), $("inspector"), {
  select: (id) => select(id),
  verdict: (id, reward) => setVerdict(id, reward),
  lane: (id, itc) => labels.change("change ITC", id, () => ({ itc_id: itc })),
  note: (id, note) => labels.change("note", id, (s) => ((s.rationale ?? "") === note ? null : { rationale: note })),
  remove: (id) => remove(id),
  decide: (id, decision) => decide(id, decision),
});
const queue = new Queue($("episodes"), { open: (id) => open(id) });

// ---- time ----

function show(f) {
  frame = clock.clamp(Number.isFinite(f) ? f : 0);
  viewer.seek(clock.ns[frame]);
  timeline.follow(frame);
  drawTime();
}

function seek(f) {
  if (player.playing) pause();
  show(f);
}

function play() {
  const segment = looping ? labels.get(selected) : null;
  const [from, to] = segment ? [segment.start_frame, segment.end_frame] : [0, clock.last];
  const start = frame >= to || frame < from ? from : frame;
  // A looped segment shows its last frame as long as any other.
  const end = segment ? (clock.ns[to + 1] ?? clock.ns[to] + 1e9 / episode.rate_hz) - 1 : clock.ns[to];
  player.play(clock.ns[start], end, { loopFromNs: segment ? clock.ns[from] : null, onEnd: draw });
  draw();
}

function pause() {
  player.stop();
  show(frame);
  draw();
}

function togglePlay() {
  if (player.playing) pause();
  else play();
}

function toggleLoop() {
  looping = !looping && labels.get(selected) !== undefined;
  if (looping) play();
  else pause();
}

function jumpEvent(direction) {
  const found = direction > 0 ? events.find((e) => e.frame > frame) : events.findLast((e) => e.frame < frame);
  if (!found) return hint(events.length ? "No event further on." : "No events were found in this recording.");
  seek(found.frame);
  hint(`${found.kind} in ${found.stream}`);
}

// ---- segments ----

function select(id, jump = true) {
  selected = id;
  const segment = labels.get(id);
  if (segment) {
    lane = Math.max(0, lanes().findIndex((itc) => itc.itc_id === segment.itc_id));
    if (jump) seek(segment.start_frame);
  }
  draw();
}

// The new segment is selected at once: a verdict pressed before the server has answered is for it.
async function add(start, end, action) {
  const id = uuid7();
  const { itc_id } = lanes()[lane];
  selected = id;
  await labels.edit(action, () => ({ put: [{ segment_id: id, itc_id, start_frame: start, end_frame: end, reward: null }] }));
  if (selected === id && !labels.get(id)) selected = null;
  draw();
}

function markIn() {
  mark = frame;
  hint(`In at ${frame}. Mark out with ${keys.hintFor("mark-out")}.`);
  draw();
}

function markOut() {
  if (mark === null) return hint(`Mark in first with ${keys.hintFor("mark-in")}.`);
  const [start, end] = [Math.min(mark, frame), Math.max(mark, frame)];
  mark = null;
  add(start, end, "mark segment");
}

function markWindow() {
  const start = Math.max(0, Math.min(frame - Math.floor(WINDOW / 2), clock.last - WINDOW + 1));
  add(start, Math.min(clock.last, start + WINDOW - 1), "mark window");
}

function setVerdict(id, reward) {
  if (labels.isProposal(id)) return decide(id, "edit", { reward });
  if (!id) return hint("Select or mark a segment first.");
  labels.change("verdict", id, (s) => (s.reward === reward ? null : { reward }));
}

let edgeSeen = null; // where an edge will be when the edits that wait are saved
// Moves one edge, keeping start <= end and both inside the episode.
function setEdge(id, edge, where) {
  if (!id || labels.isProposal(id)) return hint("Select one of your segments first.");
  const move = (s) => {
    const to = clock.clamp(where(s[edge]));
    return edge === "start_frame" ? Math.min(to, s.end_frame) : Math.max(to, s.start_frame);
  };
  // The picture follows at once; the edge is worked out again when the edits before this one are saved.
  const seen = labels.get(id);
  if (seen) seek(move(edgeSeen?.segment_id === id && labels.line.waiting ? { ...seen, [edge]: edgeSeen[edge] ?? seen[edge] } : seen));
  edgeSeen = seen ? { segment_id: id, [edge]: frame } : null;
  labels.change("move edge", id, (s) => (move(s) === s[edge] ? null : { [edge]: move(s) }));
}

function snap() {
  const segment = current();
  if (!segment) return hint("Select one of your segments first.");
  const nearStart = Math.abs(frame - segment.start_frame) <= Math.abs(frame - segment.end_frame);
  const edge = nearStart ? "start_frame" : "end_frame";
  const near = events
    .filter((e) => Math.abs(e.frame - segment[edge]) <= SNAP)
    .toSorted((a, b) => Math.abs(a.frame - segment[edge]) - Math.abs(b.frame - segment[edge]))[0];
  if (!near) return hint(`No event within ${SNAP} frames of that edge.`);
  setEdge(segment.segment_id, edge, () => near.frame);
  hint(`Snapped to ${near.kind} at ${near.frame}`);
}

function remove(id) {
  if (!id || labels.isProposal(id)) return hint("Select one of your segments first.");
  labels.edit("delete", () => (labels.segments.some((s) => s.segment_id === id) ? { remove: [id] } : null));
  if (selected === id) selected = null;
}

function step(direction) {
  const all = [...labels.segments.filter((s) => s.status !== "rejected"), ...labels.proposals].toSorted((a, b) => a.start_frame - b.start_frame);
  if (!all.length) return hint("No segments in this episode yet.");
  const index = all.findIndex((s) => s.segment_id === selected);
  select(all[index < 0 ? (direction > 0 ? 0 : all.length - 1) : (index + direction + all.length) % all.length].segment_id);
}

// ---- proposals ----

// A verdict given to a proposal takes it over with that verdict. What is taken over is selected at once.
async function decide(id, decision, verdict = {}) {
  if (!labels.isProposal(id)) return hint("Select a proposal first.");
  if (decision === "accept" && labels.get(id).reward === null) {
    return hint(`It has no verdict: ${keys.hintFor("pass")} takes it over as pass, ${keys.hintFor("fail")} as fail.`);
  }
  const row = uuid7();
  if (decision === "edit") selected = row;
  const answer = await labels.decide(id, decision, { segment_id: row, ...verdict });
  if (!answer) return select(labels.get(id) ? id : null, false);
  if (decision !== "edit") nextProposal(false);
  else draw();
}

// Proposals of an episode, then those of the next one: the largest expected change of label first.
async function nextProposal(say = true) {
  const change = (p) => (p.reward === null ? 1 : 1 - (p.confidence ?? 0.5)) * (p.end_frame - p.start_frame + 1);
  const waiting = labels.proposals.toSorted((a, b) => change(b) - change(a));
  const at = waiting.findIndex((p) => p.segment_id === selected);
  if (waiting.length) return select(waiting[(at + 1) % waiting.length].segment_id);
  selected = null;
  draw();
  if (!say) return hint(`No more proposals here. ${keys.hintFor("next-proposal")} goes to the next episode that has some.`);
  await queue.refresh();
  const id = queue.withProposals(episode.episode_id);
  if (!id) return hint("No proposals are left.");
  await open(id);
  if (labels.proposals.length) nextProposal();
}

// ---- keys ----

const onSelected = (work) => () => work(selected);
const nudge = (edge, by) => () => setEdge(selected, edge, (at) => at + by);
const keys = new Keys(
  [
    { id: "play", group: "Time", label: "Play or pause", keys: ["Space"], run: togglePlay },
    { id: "back", group: "Time", label: "One frame back", keys: ["ArrowLeft"], repeat: true, run: () => seek(frame - 1) },
    { id: "forward", group: "Time", label: "One frame on", keys: ["ArrowRight"], repeat: true, run: () => seek(frame + 1) },
    { id: "far-back", group: "Time", label: `${FAR} frames back`, keys: ["Shift+ArrowLeft"], repeat: true, run: () => seek(frame - FAR) },
    { id: "far-forward", group: "Time", label: `${FAR} frames on`, keys: ["Shift+ArrowRight"], repeat: true, run: () => seek(frame + FAR) },
    { id: "first", group: "Time", label: "First frame", keys: ["Home"], run: () => seek(0) },
    { id: "last", group: "Time", label: "Last frame", keys: ["End"], run: () => seek(clock.last) },
    { id: "slower", group: "Time", label: "Slower", keys: ["-"], run: () => speed(-1) },
    { id: "faster", group: "Time", label: "Faster", keys: ["=", "+"], run: () => speed(1) },
    { id: "next-event", group: "Time", label: "Next event", keys: ["e"], run: () => jumpEvent(1) },
    { id: "previous-event", group: "Time", label: "Previous event", keys: ["E"], run: () => jumpEvent(-1) },
    { id: "loop", group: "Time", label: "Loop the segment", keys: ["l"], run: toggleLoop },
    { id: "zoom", group: "Time", label: "Zoom to the segment, or out", keys: ["c"], run: zoom },
    { id: "mark-in", group: "Mark", label: "Mark in", keys: ["i"], run: markIn },
    { id: "mark-out", group: "Mark", label: "Mark out", keys: ["o"], run: markOut },
    { id: "window", group: "Mark", label: `Mark ${WINDOW} frames around here`, keys: ["w"], run: markWindow },
    { id: "hold", group: "Mark", label: "Hold to mark while playing", keys: ["h"], run: markIn, up: markOut },
    { id: "unmark", group: "Mark", label: "Forget the in mark, deselect", keys: ["Escape"], run: forget },
    ...Array.from({ length: 9 }, (_, k) => ({
      id: `lane-${k + 1}`, group: "Mark", label: `Lane ${k + 1}`, keys: [String(k + 1)], run: () => chooseLane(k),
    })),
    { id: "pass", group: "Segment", label: "Verdict: pass", keys: ["p"], run: onSelected((id) => setVerdict(id, 1)) },
    { id: "fail", group: "Segment", label: "Verdict: fail", keys: ["f"], run: onSelected((id) => setVerdict(id, 0)) },
    { id: "undecided", group: "Segment", label: "Verdict: undecided", keys: ["u"], run: onSelected((id) => setVerdict(id, null)) },
    { id: "next", group: "Segment", label: "Next segment", keys: ["j", "ArrowDown"], run: () => step(1) },
    { id: "previous", group: "Segment", label: "Previous segment", keys: ["k", "ArrowUp"], run: () => step(-1) },
    { id: "start-earlier", group: "Segment", label: "Start 1 earlier", keys: ["["], repeat: true, run: nudge("start_frame", -1) },
    { id: "start-later", group: "Segment", label: "Start 1 later", keys: ["]"], repeat: true, run: nudge("start_frame", 1) },
    { id: "start-far-earlier", group: "Segment", label: `Start ${FAR} earlier`, keys: ["{"], repeat: true, run: nudge("start_frame", -FAR) },
    { id: "start-far-later", group: "Segment", label: `Start ${FAR} later`, keys: ["}"], repeat: true, run: nudge("start_frame", FAR) },
    { id: "end-earlier", group: "Segment", label: "End 1 earlier", keys: [","], repeat: true, run: nudge("end_frame", -1) },
    { id: "end-later", group: "Segment", label: "End 1 later", keys: ["."], repeat: true, run: nudge("end_frame", 1) },
    { id: "end-far-earlier", group: "Segment", label: `End ${FAR} earlier`, keys: ["<"], repeat: true, run: nudge("end_frame", -FAR) },
    { id: "end-far-later", group: "Segment", label: `End ${FAR} later`, keys: [">"], repeat: true, run: nudge("end_frame", FAR) },
    { id: "start-here", group: "Segment", label: "Start at this frame", keys: ["I"], run: () => setEdge(selected, "start_frame", () => frame) },
    { id: "end-here", group: "Segment", label: "End at this frame", keys: ["O"], run: () => setEdge(selected, "end_frame", () => frame) },
    { id: "snap", group: "Segment", label: "Snap the nearer edge to an event", keys: ["s"], run: snap },
    { id: "note", group: "Segment", label: "Write a note (Esc to leave)", keys: ["t"], run: () => (current() ? inspector.focusNote() : hint("Select one of your segments first.")) },
    { id: "delete", group: "Segment", label: "Delete", keys: ["Delete", "x", "Backspace"], run: onSelected(remove) },
    { id: "undo", group: "Edits", label: "Undo", keys: ["Ctrl+z", "z"], run: () => labels.undo() },
    { id: "redo", group: "Edits", label: "Redo", keys: ["Ctrl+Shift+z", "Z", "Ctrl+y"], run: () => labels.redo() },
    { id: "next-proposal", group: "Proposals", label: "Next proposal", keys: ["q"], run: () => nextProposal() },
    { id: "accept", group: "Proposals", label: "Accept", keys: ["a"], run: onSelected((id) => decide(id, "accept")) },
    { id: "edit", group: "Proposals", label: "Take over and edit", keys: ["d"], run: onSelected((id) => decide(id, "edit")) },
    { id: "reject", group: "Proposals", label: "Reject", keys: ["r"], run: onSelected((id) => decide(id, "reject")) },
    { id: "next-episode", group: "Episodes", label: "Next episode", keys: ["n", "PageDown"], run: () => openBeside(1) },
    { id: "previous-episode", group: "Episodes", label: "Previous episode", keys: ["N", "PageUp"], run: () => openBeside(-1) },
    { id: "find", group: "Episodes", label: "Find an episode", keys: ["/"], run: () => $("find").focus() },
    { id: "help", group: "Episodes", label: "Show all keys", keys: ["?"], run: () => keys.show() },
  ],
  { dialog: $("help"), ready: () => episode !== null, onChange: () => (draw(), hint(idleHint())) },
);

function speed(by) {
  player.changeSpeed(by);
  draw();
}

function zoom() {
  const segment = labels.get(selected);
  const [from, to] = timeline.view;
  if (segment && to - from > clock.last) timeline.zoomTo(segment.start_frame, segment.end_frame);
  else timeline.fit();
}

function forget() {
  mark = null;
  selected = null;
  if (looping && player.playing) pause();
  looping = false;
  draw();
}

function chooseLane(k) {
  if (k >= lanes().length) return;
  lane = k;
  draw();
}

function openBeside(by) {
  const id = queue.beside(episode?.episode_id, by);
  if (id) open(id);
  else hint("No episode further on.");
}

// ---- drawing ----

let drawn = false;
function drawTime() {
  if (drawn) return;
  drawn = true;
  requestAnimationFrame(() => {
    drawn = false;
    timeline.draw();
    text("frame", String(frame));
    text("time", `${(clock.ns[frame] / 1e9).toFixed(3)} s of ${(clock.ns[clock.last] / 1e9).toFixed(1)} s`);
    describe();
  });
}

function draw() {
  text("play", player.playing ? "❚❚" : "▶");
  text("speed", `${player.speed}×`);
  text("last-frame", String(clock.last));
  $("mark").hidden = mark === null;
  text("mark", mark === null ? "" : `in at ${mark}`);
  $("loop").hidden = !looping;
  $("undo").disabled = !labels.canUndo;
  $("redo").disabled = !labels.canRedo;
  lane = Math.max(0, Math.min(lane, lanes().length - 1));
  const names = lanes().map((itc, k) =>
    make("button", { textContent: `${k + 1}  ${laneName(itc)}`, title: itc.statement, "aria-pressed": String(k === lane), onclick: () => chooseLane(k) }),
  );
  $("lane-names").replaceChildren(...names);
  inspector.draw(labels, selected, lanes(), (id) => keys.hintFor(id));
  text("count", labels.segments.length + labels.proposals.length ? `${labels.segments.length} yours, ${labels.proposals.length} proposed` : "");
  drawTime();
}

export const laneName = (itc) => `${itc.itc_id.split("/").at(-1).replaceAll("_", " ")}`;

// One sentence for a screen reader, and the same as data for tests.
function describe() {
  const segment = labels.get(selected);
  const verdict = segment && { 1: "pass", 0: "fail", null: "undecided" }[segment.reward];
  const about = segment
    ? `Selected ${labels.isProposal(selected) ? "proposal" : "segment"} ${segment.start_frame} to ${segment.end_frame}, ${verdict}.`
    : "Nothing selected.";
  const state = $("state");
  Object.assign(state.dataset, {
    episode: episode?.episode_id ?? "", frame, lane: lanes()[lane]?.itc_id ?? "", version: labels.version, selected: selected ?? "",
    mark: mark ?? "", segments: labels.segments.length, proposals: labels.proposals.length, playing: player.playing, events: events.length,
  });
  if (!player.playing) text("state", `Frame ${frame} of ${clock.last}. Lane ${lane + 1}. ${about} ${mark === null ? "" : `In mark at ${mark}.`}`);
}

function saved(state, message) {
  $("saved").dataset.state = state;
  text("saved", message);
}

let hintTimer = 0;
function hint(message) {
  text("hint", message);
  clearTimeout(hintTimer);
  hintTimer = setTimeout(() => text("hint", idleHint()), 6000);
}

function idleHint() {
  return ["mark-in", "mark-out", "pass", "fail", "next-episode"].map((id) => `${keys.hintFor(id)} ${id.replace("-", " ")}`).join("  ·  ");
}

function warn(message) {
  const close = make("button", { textContent: "Dismiss", onclick: () => ($("alert").hidden = true) });
  $("alert").replaceChildren(message, close);
  $("alert").hidden = false;
}

// What is wrong with a recording shows once; reading its pictures may bring more to light.
let told = "";
function warnOf(problems) {
  const message = problems.slice(0, 6).join("\n") + (problems.length > 6 ? `\n… and ${problems.length - 6} more: see jiti inspect.` : "");
  if (message && message !== told) warn(message);
  told = message;
}

// ---- episodes ----

let opening = 0;
async function open(id, at = 0) {
  const mine = ++opening;
  player.stop();
  let answer;
  try {
    await labels.idle(); // edits of the episode that is shown come first
    answer = await call(episodePath(id));
    await labels.idle();
  } catch (error) {
    queue.mark(id);
    if (mine === opening) close();
    return warn(error.message);
  }
  if (mine !== opening) return; // another one was asked for meanwhile
  looping = false;
  mark = null;
  selected = null;
  events = [];
  episode = answer;
  clock = new Clock(answer.display_ns);
  lane = 0;
  $("alert").hidden = true;
  document.title = `${answer.title} · jiti annotate`;
  text("title", answer.title);
  text("instruction", answer.instruction ?? answer.task.instruction ?? "");
  $("instruction").title = answer.instruction ?? "";
  history.replaceState(null, "", `/?${new URLSearchParams({ episode: id })}`);
  saved("idle", answer.version ? `Saved · ${answer.version}` : "Nothing to save");
  labels.take(id, answer);
  warnOf([...answer.problems, ...labels.problems]);
  queue.current(id);
  timeline.fit();
  show(at);
  draw();
  hint(idleHint());
  await prepare(id);
  if (episode?.episode_id !== id) return;
  viewer.open(episodePath(id, "/recording.rrd"));
  call(episodePath(id, "/events")).then((found) => {
    if (episode?.episode_id !== id) return;
    events = found.events;
    drawTime();
  }, (error) => hint(error.message));
}

// Nothing is open: keys must not reach the episode that was open before.
function close() {
  episode = null;
  [clock, lane, mark, selected, looping, events] = [new Clock([0]), 0, null, null, false, []];
  viewer.close();
  $("loading").hidden = true;
  document.title = "jiti annotate";
  text("title", "No episode is open");
  text("instruction", "");
  saved("idle", "Nothing to save");
  queue.current(null);
  labels.take(null, NO_LABELS);
  show(0);
}

// A recording that must be shown through a lighter copy says how far that is; the copy is shown while it grows.
async function prepare(id) {
  $("loading").hidden = true;
  if (!episode.proxy_reason) return;
  const reason = episode.proxy_reason;
  const watch = async () => {
    if (episode?.episode_id !== id) return;
    const { proxy } = await call(episodePath(id, "/proxy"));
    if (!proxy || episode?.episode_id !== id) return;
    $("loading").hidden = proxy.done;
    if (proxy.error) return warn(proxy.error);
    const left = proxy.seconds_left === null ? "" : `, about ${Math.ceil(proxy.seconds_left)} s left`;
    $("loading").querySelector("p").textContent = `Making a lighter copy (${reason}): frame ${proxy.frames_done} of ${proxy.frame_count}${left}`;
    $("loading").querySelector("progress").value = proxy.frames_done / Math.max(1, proxy.frame_count);
    if (!proxy.done) setTimeout(watch, 700);
  };
  await watch();
}

async function watchVersion() {
  try {
    const id = episode?.episode_id;
    const { version, problems } = await call(`/api/version${id ? `?${new URLSearchParams({ episode: id })}` : ""}`);
    if (id && id === episode?.episode_id) warnOf([...problems, ...labels.problems]);
    if (version !== lastVersion && document.visibilityState === "visible") {
      lastVersion = version;
      await queue.refresh();
      if (episode) await labels.refresh();
    }
  } catch (error) {
    if (error.status === 0) saved("failed", "Server does not answer");
  }
  setTimeout(watchVersion, 2000);
}

$("play").onclick = togglePlay;
$("undo").onclick = () => labels.undo();
$("redo").onclick = () => labels.redo();
$("help-button").onclick = () => keys.show();
$("reset-keys").onclick = () => keys.reset();
$("theme").onclick = () => {
  setTheme(theme() === "dark" ? "light" : "dark");
  const at = new URLSearchParams({ episode: episode?.episode_id ?? "", frame });
  location.replace(`/?${at}`); // Rerun's viewer takes its theme when it starts
};
// After a click on a button, keys are the annotator's again.
addEventListener("click", (event) => event.target.closest?.("button, summary") && !event.target.closest("dialog") && document.activeElement?.blur?.());

try {
  const [about] = await Promise.all([call("/api/about"), keys.load(), queue.refresh()]);
  text("annotator", `as ${about.annotator}`);
  $("annotator").title = `Labels go to ${about.labels}`;
  if (about.problems.length) warn(about.problems.join("\n"));
  const asked = new URLSearchParams(location.search);
  const first = asked.get("episode") || queue.first();
  if (first) await open(first, Number(asked.get("frame") ?? 0));
  if (labels.get(asked.get("segment"))) select(asked.get("segment"), false);
  if (!first) warn("This source has no episode that can be opened.");
} catch (error) {
  warn(error.message);
}
watchVersion();

// A UUIDv7, as the label store makes them: milliseconds, then random bits.
function uuid7() {
  const random = crypto.getRandomValues(new Uint8Array(10));
  random[0] = (random[0] & 0x0f) | 0x70;
  random[2] = (random[2] & 0x3f) | 0x80;
  const hex = Date.now().toString(16).padStart(12, "0") + [...random].map((b) => b.toString(16).padStart(2, "0")).join("");
  return hex.replace(/^(.{8})(.{4})(.{4})(.{4})(.{12})$/, "$1-$2-$3-$4-$5");
}
