// The Reward Validation Viewer: the whole dataset, its suspects, and one episode with returns under the video.

import { call, count, episodePath, make, setTheme, text, theme } from "/static/api.js";
import { Clock, Player } from "/static/clock.js";
import { Viewer } from "/static/viewer.js";
import { Chart } from "/rewards/static/chart.js";
import { Differences } from "/rewards/static/differences.js";
import { RewardMap } from "/rewards/static/map.js";

setTheme(theme());
const $ = (id) => document.getElementById(id);
const DEFAULT_GAMMA = 0.98;

let gamma = Number(new URLSearchParams(location.search).get("gamma") ?? DEFAULT_GAMMA);
let overview = null;
let suspects = [];
let compared = false; // whether all trajectories were, which takes a while
let episode = null;
let clock = new Clock([0]);
let viewer = null;
let lastVersion = null;
let suspectTimer = 0;

const map = new RewardMap($("map"), {
  onChoose: (row, share) => open(overview.episodes[row].episode_id, null, share),
  onHover: (row) => ($("map").title = overview.episodes[row].title),
});
const chart = new Chart($("chart"), { onSeek: (frame) => seek(frame) });
const player = new Player((ns) => show(clock.frameAt(ns)));
const differences = new Differences($("differences"), { onOpen: (id, frame) => open(id, frame), esaLink, onSettled: () => refresh(), onTrouble: (error) => warn(error.message) });

// ---- the dataset ----

// Only the newest question's answer counts, whatever order the answers come in.
const asked = { refresh: 0, open: 0 };
async function refresh() {
  const mine = ++asked.refresh;
  try {
    const answer = await call(`/api/rewards?gamma=${gamma}`);
    if (mine !== asked.refresh) return;
    overview = answer;
  } catch (error) {
    return warn(error.message);
  }
  lastVersion = overview.version;
  const bytes = (name) => Uint8Array.from(atob(overview[name]), (c) => c.charCodeAt(0));
  overview.stateBins = bytes("states");
  overview.returnBins = bytes("returns");
  const { totals } = overview;
  text("summary", `${count(totals.episodes, "episode")}, ${totals.labelled} labelled, ${count(totals.segments, "segment")}, ${Math.round(totals.positive_share * 100)}% of annotated frames pass`);
  text("scale", `0 to ${overview.return_max.toPrecision(3)}`);
  drawMap();
  differences.annotators(overview.annotators);
  await readSuspects().catch((error) => warn(error.message));
  if ($("order").value === "suspects") drawMap();
  if (episode) await readEpisode(episode.episode_id).catch((error) => warn(error.message));
  describe();
}

function drawMap() {
  if (!overview) return;
  const rows = overview.episodes.map((_, k) => k);
  const worst = new Map(suspects.map((s, k) => [s.episode_id, k]).toReversed());
  const by = {
    name: () => 0,
    return: (k) => -overview.episodes[k].mean_return,
    reward: (k) => -overview.episodes[k].reward_share,
    suspects: (k) => worst.get(overview.episodes[k].episode_id) ?? Infinity,
  }[$("order").value];
  const key = rows.map(by);
  rows.sort((a, b) => (key[a] < key[b] ? -1 : key[a] > key[b] ? 1 : a - b));
  map.show({ bins: overview.bins, states: overview.stateBins, returns: overview.returnBins, order: rows });
}

// Trajectories are compared while the first answer is already shown.
async function readSuspects() {
  const found = await call(`/api/rewards/suspects?gamma=${gamma}`);
  suspects = found.suspects;
  compared = found.complete;
  drawSuspects();
  clearTimeout(suspectTimer);
  if (!found.complete) suspectTimer = setTimeout(readSuspects, 1500);
  describe();
}

function drawSuspects() {
  text("suspect-count", `(${suspects.length})`);
  const rows = suspects.slice(0, 300).map((suspect, k) => {
    const link = make("a", { href: esaLink(suspect), target: "jiti-esa", textContent: "Fix in ESA", data: { suspect: k } });
    const look = make("button", { textContent: "Look", onclick: () => open(suspect.episode_id, suspect.start_frame) });
    const item = make(
      "li",
      { data: { kind: suspect.kind, episode: suspect.episode_id } },
      make("span", { className: suspect.severity, textContent: suspect.severity }),
      make("span", { className: "what" }, make("span", { className: "kind", textContent: `${suspect.kind.replaceAll("_", " ")} ` }), make("span", { textContent: `${where(suspect)}: ` }), suspect.message + ".", make("span", { className: "quiet", textContent: ` ${suspect.remedy}` })),
      make("span", {}, look, " ", suspect.episode_id ? link : null),
    );
    return item;
  });
  if (!compared) rows.push(make("li", { className: "none quiet", textContent: "Still comparing trajectories…" }));
  else if (!rows.length) rows.push(make("li", { className: "none quiet", textContent: "Nothing looks wrong." }));
  if (suspects.length > 300) rows.push(make("li", { className: "none quiet", textContent: `… and ${suspects.length - 300} more: jiti validate-rewards --check lists all.` }));
  $("suspects").replaceChildren(...rows);
}

function where({ episode_id, annotator, itc_id }) {
  return [episode_id, itc_id.split("/").at(-1), annotator].filter(Boolean).join(" · ");
}

function esaLink({ episode_id, start_frame, segment_id }) {
  return `/?${new URLSearchParams({ episode: episode_id ?? "", frame: start_frame ?? 0, segment: segment_id ?? "" })}`;
}

// ---- one episode ----

async function open(id, frame, share = 0) {
  if (!id) return;
  player.stop();
  const mine = ++asked.open;
  try {
    const answer = await call(episodePath(id));
    if (mine !== asked.open) return;
    const changed = episode?.episode_id !== id;
    episode = answer;
    clock = new Clock(answer.display_ns);
    viewer ??= new Viewer($("viewer"), theme(), {
      onSeek: (ns) => seek(clock.frameAt(ns + 1)),
      onOpen: () => (document.body.dataset.recording = episode.recording_id),
    });
    if (changed) viewer.open(episodePath(id, "/recording.rrd"));
    await readEpisode(id);
    seek(frame ?? share * clock.last);
    map.chosen = overview.episodes.findIndex((e) => e.episode_id === id);
    map.draw();
  } catch (error) {
    warn(error.message);
  }
}

async function readEpisode(id) {
  const answer = await call(`/api/rewards/episodes/${encodeURIComponent(id)}?gamma=${gamma}`);
  if (id !== episode.episode_id) return;
  chart.data = answer;
  chart.draw();
  text("episode", episode.title);
  $("play").disabled = false;
  $("to-esa").hidden = false;
}

function show(frame) {
  chart.frame = clock.clamp(frame);
  viewer?.seek(clock.ns[chart.frame]);
  chart.draw();
  text("at", `frame ${chart.frame} of ${clock.last}`);
  $("to-esa").href = esaLink({ episode_id: episode.episode_id, start_frame: chart.frame });
  describe();
}

function seek(frame) {
  player.stop();
  text("play", "▶");
  show(frame);
}

function togglePlay() {
  if (!episode) return;
  if (player.playing) return seek(chart.frame);
  text("play", "❚❚");
  player.play(chart.frame >= clock.last ? 0 : clock.ns[chart.frame], clock.ns[clock.last], { onEnd: () => text("play", "▶") });
}

function describe() {
  const state = $("state");
  Object.assign(state.dataset, {
    episode: episode?.episode_id ?? "", frame: chart.frame, suspects: suspects.length, version: overview?.version ?? "", gamma,
  });
  if (!player.playing) text("state", `${count(overview?.totals.episodes ?? 0, "episode")}, ${count(suspects.length, "suspect")}. ${episode ? `${episode.title}, frame ${chart.frame}.` : ""}`);
}

function warn(message) {
  $("alert").replaceChildren(message, make("button", { textContent: "Dismiss", onclick: () => ($("alert").hidden = true) }));
  $("alert").hidden = false;
}

// ---- controls ----

function tab(name) {
  for (const one of ["suspects", "differences"]) {
    $(one).hidden = one !== name;
    $(`tab-${one}`).setAttribute("aria-selected", String(one === name));
  }
  if (name === "differences") differences.load();
}

let gammaTimer = 0;
function setGamma(value) {
  gamma = value;
  text("gamma-value", value.toFixed(3));
  clearTimeout(gammaTimer);
  gammaTimer = setTimeout(refresh, 150);
}

$("tab-suspects").onclick = () => tab("suspects");
$("tab-differences").onclick = () => tab("differences");
$("gamma").value = gamma;
text("gamma-value", gamma.toFixed(3));
$("gamma").oninput = () => setGamma(Number($("gamma").value));
$("order").onchange = drawMap;
$("play").onclick = togglePlay;
$("theme").onclick = () => {
  setTheme(theme() === "dark" ? "light" : "dark");
  location.reload(); // Rerun's viewer takes its theme when it starts
};
window.addEventListener("keydown", (event) => {
  if (event.target instanceof Element && event.target.closest("input, select, textarea, button")) return;
  const act = { " ": togglePlay, ArrowLeft: () => seek(chart.frame - 1), ArrowRight: () => seek(chart.frame + 1), Home: () => seek(0), End: () => seek(clock.last) }[event.key];
  if (!act || !episode || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  act();
}, true);

// ---- live ----

async function watchVersion() {
  try {
    const { version } = await call("/api/version");
    if (version === lastVersion) return;
    lastVersion = version; // asked for, so that a slow answer is not asked for twice
    await refresh();
  } catch (error) {
    warn(error.message);
  }
}
new BroadcastChannel("jiti-labels").onmessage = watchVersion;
setInterval(watchVersion, 2000);
await refresh();
watchVersion();
