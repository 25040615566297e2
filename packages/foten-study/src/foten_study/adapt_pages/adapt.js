// A user's session: tones that light up, then pairs of textures beside a real surface. The server asks and keeps; this page plays.
import "./foten-pad.js";
import { painted } from "./painter.js";
import { Settings } from "./settings.js";
import { titled } from "./shelf.js";

const TONE_S = 0.45, PAUSE_S = 0.2, LEAD_S = 0.15; // of an interval, between two, before the first
const LABELS = { detect: "feel", compare: "compare", match: "match" };
const ASKS = { detect: "Which one vibrated?", compare: "Which was stronger?" };
const LISTENS = { detect: "One of the three vibrates.", compare: "Both vibrate." };
const MOVES = { level: ["louder", "dB", 1], brighter: ["brighter", "octaves", 2], wider: ["wider", "octaves", 2], rougher: ["rougher", "dB", 1] };

const $ = (id) => document.getElementById(id);
const { sound, pad } = document.querySelector("foten-pad");
const settings = new Settings($("panel"), sound, pad);
let state = null, reference = null; // reference: what the texture says of itself

/** Ask the server; throws its line for people where it refuses. */
async function asked(path, body) {
  const answer = await fetch(path, body && { method: "POST", body: JSON.stringify(body) });
  if (!answer.ok) throw new Error((await answer.text()).trim() || `${path}: ${answer.status}`);
  return answer;
}

function say(line) {
  $("message").textContent = line;
  $("message").hidden = !line;
}

async function attempt(how) {
  try {
    say("");
    await how();
  } catch (error) {
    say(error.message);
    const again = Object.assign(document.createElement("button"), { type: "button", className: "link", textContent: "Try again" });
    again.addEventListener("click", () => attempt(resume));
    $("message").append(" ", again);
  }
}

/** Go on as the server has it. */
async function resume() {
  state = await (await asked("session")).json();
  await go();
}

const wait = (seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));

// What is shown

function view(id) {
  for (const one of ["start", "tones", "match", "end"]) $(one).hidden = one !== id;
}

function drawProgress() {
  const part = state.question?.part;
  $("parts").replaceChildren(
    ...Object.entries(state.progress).map(([name, share]) => {
      const item = document.createElement("li"), bar = Object.assign(document.createElement("progress"), { max: 1, value: share });
      bar.setAttribute("aria-label", LABELS[name]);
      if (name === part) item.setAttribute("aria-current", "step");
      item.append(LABELS[name], bar);
      return item;
    }),
  );
}

async function go() {
  drawProgress();
  const { question } = state;
  if (!question) return end();
  if (question.part === "match") return match();
  return tones(question);
}

/** Tell the server, and go on with what it asks then: also where it refused, or another page was quicker. */
async function answer(message) {
  let refused = "";
  try {
    state = await (await asked("answer", message)).json();
  } catch (error) {
    refused = error.message;
    state = await (await asked("session")).json();
  }
  await go();
  if (refused) say(refused);
}

// Tones

/** Peak of full scale of a tone [dB re the largest]: an actuator's largest is what its limit leaves straight. */
function peakOf(db) {
  const one = state.actuator;
  return 10 ** (db / 20) * (one?.limit ? (one.knee * one.limit) / one.full_scale : 1 / (one?.full_scale ?? 1));
}

async function tones({ n, part, tones }) {
  view("tones");
  const lights = tones.map((_, i) => {
    const light = Object.assign(document.createElement("button"), { type: "button", textContent: String(i + 1), disabled: true });
    light.addEventListener("click", () => {
      for (const one of lights) one.disabled = true;
      attempt(() => answer({ n, which: i }));
    });
    return light;
  });
  $("lights").replaceChildren(...lights);
  $("ask").textContent = LISTENS[part];
  $("hint").textContent = "";
  const begins = tones.map((_, i) => LEAD_S + i * (TONE_S + PAUSE_S));
  await sound.start();
  sound.setVolume(0); // what is measured is re full scale
  sound.burst(tones.map((tone, i) => tone && [begins[i], tone[0], peakOf(tone[1]), TONE_S]).filter(Boolean), begins.at(-1) + TONE_S);
  for (const [i, begin] of begins.entries()) {
    await wait(i ? PAUSE_S : begin);
    lights[i].classList.add("on");
    await wait(TONE_S);
    lights[i].classList.remove("on");
  }
  $("ask").textContent = ASKS[part];
  $("hint").textContent = part === "detect" ? "Not sure? Guess." : "";
  for (const light of lights) light.disabled = false;
  lights[0].focus({ preventScroll: true });
}

addEventListener("keydown", (e) => {
  const light = $("lights").children[Number(e.key) - 1];
  if (!$("tones").hidden && !$("panel").open && light && !e.repeat) light.click();
});

// Pairs

/** Radio buttons for textures under the pen; `chosen(i)` is told which. */
function choices(names, chosen) {
  const buttons = names.map((name, i) => {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: name });
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => {
      for (const other of buttons) other.setAttribute("aria-checked", String(other === button));
      sound.use(`side-${i}`);
      chosen(i);
    });
    return button;
  });
  $("choice").querySelector("[role=radiogroup]").replaceChildren(...buttons);
  buttons.at(0).click();
}

/** Have textures ready as `side-0` and `side-1`, at one scale. */
async function load(paths) {
  const fetched = await Promise.all(["textures/plain.foten", ...paths].map(async (path) => (await asked(path)).arrayBuffer()));
  const [plain, ...sides] = fetched;
  await sound.start();
  sound.setVolume(state.profile.volume_db);
  if (!reference) {
    reference = await sound.load("plain", plain.slice());
    painted(plain, state.texture).then(({ canvas, mm }) => pad.setTile(canvas, mm), () => {});
  }
  for (const [i, bytes] of sides.entries()) sound.know(`side-${i}`, { ...(await sound.load(`side-${i}`, bytes)), accelerationSd: reference.accelerationSd });
}

/** The loudness of an output that is not known is set by hand, once. */
async function volume() {
  view("match");
  const slider = Object.assign(document.createElement("input"), { type: "range", min: -40, max: 12, step: 1, value: -6 });
  slider.setAttribute("aria-label", "Volume");
  slider.addEventListener("input", () => sound.setVolume(Number(slider.value)));
  $("choice").querySelector("h2").textContent = "About as strong as the real surface?";
  $("stop").hidden = true;
  await load(["textures/equal.foten"]);
  sound.setVolume(Number(slider.value));
  sound.use("side-0");
  $("choice").querySelector("[role=radiogroup]").replaceChildren(slider);
  Object.assign($("choose"), { disabled: false, textContent: "Yes", onclick: () => attempt(() => answer({ volume_db: Number(slider.value) })) });
}

async function match() {
  if (!state.volume_set) return volume();
  const { n } = state.question, choose = $("choose"), tried = new Set();
  view("match");
  $("choice").querySelector("h2").textContent = "Which is nearer to the real surface?";
  $("stop").hidden = !state.can_stop;
  choose.disabled = true;
  choose.textContent = "One moment";
  await load([`pair/${n}/0`, `pair/${n}/1`]);
  if (state.question?.n !== n) return;
  choices(["A", "B"], (i) => {
    tried.add(i);
    choose.disabled = tried.size < 2;
    choose.textContent = tried.size < 2 ? `Try ${"AB"[1 - i]} too` : `${"AB"[i]} is nearer`;
    choose.onclick = () => {
      choose.disabled = true;
      attempt(() => answer({ n, which: i }));
    };
  });
}

$("stop").addEventListener("click", () => attempt(() => answer({ stop: true })));

// The end

async function end() {
  view("end");
  if (state.silent) {
    $("done").textContent = "Nothing was felt at 160 Hz";
    $("moves").textContent = "Is it the right output, and does the actuator move? Start again once it does.";
    return;
  }
  document.body.classList.add("ended");
  const { profile, file } = state;
  $("done").textContent = `Kept in ${file}`;
  $("curve").toggleAttribute("hidden", !profile.gain_db.length);
  if (profile.gain_db.length) drawCurve(profile);
  $("moves").replaceChildren(
    ...profile.moves.flatMap((value, i) => {
      const [name, unit, digits] = Object.values(MOVES)[i], row = document.createElement("div");
      const sign = value < 0 ? "−" : "+";
      row.innerHTML = `<dt>${name}</dt><dd>${sign}${Math.abs(value).toFixed(digits)} ± ${profile.moves_sd[i].toFixed(digits)} ${unit}</dd>`;
      return row;
    }),
  );
  if (!state.texture) return;
  await load(["textures/plain.foten", "textures/adapted.foten"]);
  $("choice").querySelector("h2").textContent = titled(state.texture);
  for (const id of ["choose", "stop"]) $(id).hidden = true;
  choices(["as learned", "yours"], () => {});
  $("choice").querySelector("[role=radio]:last-child").click();
  $("match").hidden = false;
}

/** The gains over frequency, with two standard errors. */
function drawCurve({ gain_db, gain_sd_db }) {
  const most = Math.max(6, Math.ceil(Math.max(...gain_db.map((db, i) => Math.abs(db) + 2 * gain_sd_db[i])) / 6) * 6);
  const hz = state.tones_hz, x = (f) => 50 + (350 * Math.log(f / hz[0])) / Math.log(hz.at(-1) / hz[0]), y = (db) => 95 - (80 * db) / most;
  const parts = [];
  for (const db of [-most, 0, most]) parts.push(`<line class="axis" x1="40" x2="410" y1="${y(db)}" y2="${y(db)}"/><text x="36" y="${y(db) + 4}" text-anchor="end">${db > 0 ? "+" : ""}${String(db).replace("-", "−")} dB</text>`);
  for (const f of hz) parts.push(`<text x="${x(f)}" y="196" text-anchor="middle">${f} Hz</text>`);
  parts.push(`<polyline class="line" points="${hz.map((f, i) => `${x(f)},${y(gain_db[i])}`).join(" ")}"/>`);
  for (const [i, f] of hz.entries()) parts.push(`<line class="bar" x1="${x(f)}" x2="${x(f)}" y1="${y(gain_db[i] - 2 * gain_sd_db[i])}" y2="${y(gain_db[i] + 2 * gain_sd_db[i])}"/><circle cx="${x(f)}" cy="${y(gain_db[i])}" r="4"/>`);
  $("curve").innerHTML = parts.join("");
  $("curve").setAttribute("aria-label", `Gain for equal strength: ${hz.map((f, i) => `${gain_db[i].toFixed(1)} dB at ${f} Hz`).join(", ")}`);
}

// The beginning

sound.addEventListener("failed", ({ detail }) => say(detail));
$("settings").addEventListener("click", () => settings.show());
$("go").addEventListener("click", () => attempt(async () => {
  $("go").disabled = true;
  await sound.start();
  const one = state.actuator;
  sound.actuate(one && { resonanceHz: one.resonance_hz, damping: one.damping, gain: one.gain, lowestHz: one.lowest_hz, limit: one.limit, fullScale: one.full_scale });
  await go();
}));

attempt(async () => {
  state = await (await asked("session")).json();
  drawProgress();
  const part = state.question?.part, name = titled(state.texture || "texture").toLowerCase();
  const beside = `lay ${name} beside this, and stroke both.`;
  const begins = {
    detect: "Three lights come on in turn, and one of them vibrates. Four minutes.",
    compare: "Two lights come on in turn. One minute.",
    match: beside[0].toUpperCase() + beside.slice(1),
  };
  $("what").textContent = begins[part] ?? "All was asked.";
  if (state.texture && part && part !== "match") $("what").textContent += ` Then ${beside}`;
  if (!part) $("go").textContent = "Show";
  document.documentElement.dataset.ready = "";
});
