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
  }
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

async function answer(n, which) {
  state = await (await asked("answer", { n, which })).json();
  await go();
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
      attempt(() => answer(n, i));
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
  if (!$("tones").hidden && light && !e.repeat) light.click();
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
  settings.setVolume(); // as it was chosen
  if (!reference) {
    reference = await sound.load("plain", plain.slice());
    painted(plain, state.texture).then(({ canvas, mm }) => pad.setTile(canvas, mm), () => {});
  }
  for (const [i, bytes] of sides.entries()) sound.know(`side-${i}`, { ...(await sound.load(`side-${i}`, bytes)), accelerationSd: reference.accelerationSd });
}

async function match() {
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
      attempt(() => answer(n, i));
    };
  });
}

$("stop").addEventListener("click", () => attempt(async () => {
  state = await (await asked("answer", { stop: true })).json();
  await go();
}));

// The end

async function end() {
  view("end");
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
  await sound.start();
  if (state.actuator) {
    const { resonance_hz, damping, gain, lowest_hz, limit, full_scale } = state.actuator;
    sound.actuate({ resonanceHz: resonance_hz, damping, gain, lowestHz: lowest_hz, limit, fullScale: full_scale });
  } else sound.actuate(null);
  await go();
}));

attempt(async () => {
  state = await (await asked("session")).json();
  drawProgress();
  const feels = "detect" in state.progress, name = titled(state.texture || "texture");
  if (!state.question) return end();
  const begins = { detect: "Three lights come on in turn, and one of them vibrates. Four minutes.", compare: "Two lights come on in turn. One minute." };
  $("what").textContent = begins[state.question.part] ?? `Lay ${name.toLowerCase()} beside this, and stroke both.`;
  if (feels && state.texture && state.question.part !== "match") $("what").textContent += ` Then lay ${name.toLowerCase()} beside this.`;
  document.documentElement.dataset.ready = "";
});
