// Shows what the program that drives the arm asks, sends it keys, and plays the recording that is asked about.

import { call, make, setTheme, text, theme } from "/shared/api.js";

const POLL_MS = 250;
const RATE_HZ = 30;
const PHASES = { opening: "Opening", ready: "Ready", running: "The arm moves", asking: "Judging", over: "Over" };
const byId = (id) => document.getElementById(id);

let shown = { keys: [], version: "", recording: null };
let counts = {};
let playing = true;

setTheme(theme());
byId("theme").onclick = () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");

function alertThat(message) {
  byId("alert").hidden = !message;
  text("alert", message);
}

async function press(key) {
  try {
    const { counts } = await call("/api/key", { key, version: shown.version });
    if (!counts) text("phase", "That key came too late for its question");
    await refresh();
  } catch (error) {
    alertThat(error.message);
  }
}

async function refresh() {
  let now;
  try {
    now = await call("/api/shown");
  } catch (error) {
    // The program has ended, and the page with it.
    alertThat(shown.phase === "over" ? "" : error.status ? error.message : "jiti does not answer: look at its terminal. If the arm moves, switch its power off.");
    return;
  }
  alertThat("");
  if (now.version === shown.version) return;
  const before = shown.recording;
  shown = now;
  Object.assign(byId("state").dataset, { phase: now.phase, version: now.version, recording: now.recording ?? "" });
  text("title", now.title);
  text("phase", PHASES[now.phase]);
  text("text", now.text);
  text("detail", now.detail);
  byId("keys").replaceChildren(
    ...now.keys
      .filter(([key]) => key !== " ")
      .map(([key, name, does]) => make("button", { onclick: () => press(key), data: { key } }, make("kbd", {}, name), ` ${does}`)),
  );
  byId("stop").hidden = now.phase === "over";
  text("stop-text", now.phase === "running" ? "Stop the arm" : "Stop here and go on another time");
  if (now.recording !== before) await openRecording();
}

async function openRecording() {
  try {
    counts = shown.recording ? (await call("/api/pictures")).cameras : {};
  } catch {
    counts = {}; // The question was answered meanwhile, or the recording cannot be read.
  }
  byId("look").hidden = Object.keys(counts).length === 0;
  byId("cameras").replaceChildren(
    ...Object.keys(counts).map((camera) =>
      make("figure", {}, make("img", { alt: `${camera} camera`, data: { camera } }), make("figcaption", {}, camera)),
    ),
  );
  byId("place").max = Math.max(0, ...Object.values(counts).map((count) => count - 1));
  byId("place").value = 0;
  setPlaying(true);
  draw();
}

function setPlaying(on) {
  playing = on;
  text("play", on ? "Pause" : "Play");
}

// A picture is asked for once the one before it is there: a slow machine shows fewer, and does not fall behind.
async function draw() {
  const place = Number(byId("place").value);
  text("where", `${(place / RATE_HZ).toFixed(1)} s, picture ${place}`);
  await Promise.all(
    [...document.querySelectorAll("#cameras img")].map((image) => {
      const number = Math.min(place, counts[image.dataset.camera] - 1);
      image.src = `/api/pictures/${encodeURIComponent(image.dataset.camera)}/${number}?of=${encodeURIComponent(shown.recording)}`;
      return image.decode().catch(() => {});
    }),
  );
}

async function play() {
  let began = performance.now();
  let from = 0;
  for (;;) {
    await new Promise(requestAnimationFrame);
    const last = Number(byId("place").max);
    if (!playing || byId("look").hidden) {
      began = performance.now();
      from = Number(byId("place").value);
      continue;
    }
    const place = from + Math.floor(((performance.now() - began) / 1000) * RATE_HZ);
    if (place !== Number(byId("place").value)) {
      byId("place").value = Math.min(place, last);
      await draw();
    }
    if (place >= last) setPlaying(false);
  }
}

byId("place").oninput = () => {
  setPlaying(false);
  draw();
};
byId("play").onclick = () => {
  if (!playing && byId("place").value === byId("place").max) byId("place").value = 0;
  setPlaying(!playing);
};
byId("stop").onclick = () => press(" ");

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " ") {
    // Whatever has the focus.
    event.preventDefault();
    press(" ");
    return;
  }
  const key = { Enter: "\n", Backspace: "r" }[event.key] ?? event.key;
  if (key === "p") byId("play").click();
  if (event.repeat || !shown.keys.some(([known]) => known === key)) return;
  event.preventDefault();
  press(key);
});

async function follow() {
  for (;;) {
    await refresh();
    await new Promise((done) => setTimeout(done, POLL_MS));
  }
}

follow();
play();
