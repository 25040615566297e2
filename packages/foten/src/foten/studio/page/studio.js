// The page: textures on a shelf, one of them under the pen.
import { cardOf, grouped, shipped, Texture, textureOf } from "./shelf.js";
import { Monitor } from "./monitor.js";
import { asked, painted } from "./painter.js";
import { Settings } from "./settings.js";
import "./foten-pad.js";
import { Taken } from "./stroke.js";
import { Capture } from "./capture.js";
import { Tune } from "./tune.js";

const TAP_PX = 10; // that a finger moves as it taps

const $ = (id) => document.getElementById(id);
const { sound, pad } = document.querySelector("foten-pad");
const monitor = new Monitor({
  traces: $("traces"),
  spectrogram: $("spectrogram"),
  meter: $("meter").querySelector("i"),
  numbers: { acceleration: $("acceleration"), speed: $("speed"), force: $("newtons") },
});
const settings = new Settings($("panel"), sound, pad);
const taken = new Taken($("taken"), { sound, pad, groups: () => groups, use, unit: () => $("acceleration-unit").textContent });
const others = () => textures.filter((one) => one !== chosen && one.method === "foten-plus" && !one.card);
const tune = new Tune($("tune"), sound, { one: () => chosen, others, played: about, say });
const pictures = new Map(); // by a texture's id: what surface.js made
let textures = [], groups = [], chosen = null, blind = null, server = false, cannotTrain = "";

// Pictures

function pictureOf(texture) {
  if (!pictures.has(texture.id))
    pictures.set(
      texture.id,
      texture.bytes.then(
        (bytes) =>
          cardOf(bytes).hasGraph ? plain() : painted(bytes, texture.name || texture.title),
      ),
    );
  return pictures.get(texture.id);
}

/** The picture of what this page cannot render. */
function plain() {
  const canvas = Object.assign(document.createElement("canvas"), { width: 8, height: 8 }), g = canvas.getContext("2d");
  g.fillStyle = "#77716a";
  g.fillRect(0, 0, 8, 8);
  return { canvas, mm: 24, url: canvas.toDataURL() };
}

async function paint(texture) {
  const picture = await pictureOf(texture);
  if (texture.photo) {
    const photo = new Image();
    photo.src = texture.photo;
    const isThere = await photo.decode().then(() => true, () => false);
    if (isThere) return { ...picture, canvas: photo, url: texture.photo };
  }
  return picture;
}

// The shelf

function shelve() {
  groups = grouped(textures);
  $("textures").replaceChildren(
    ...groups.map((group) => {
      const [texture] = group, swatch = document.createElement("button"), name = document.createElement("span"), item = document.createElement("li");
      const range = document.createElement("small");
      swatch.className = "swatch";
      swatch.dataset.id = texture.id;
      name.textContent = texture.title;
      name.append(range);
      swatch.append(name);
      texture.bytes.then((bytes) => (range.textContent = ranges(cardOf(bytes)).replace(", ", "\n")), () => {});
      swatch.addEventListener("click", () => attempt(async () => {
        endBlind();
        await begin();
        await use(texture);
        if (pad.pen === null) pad.play(1.8);
      }));
      paint(texture).then(({ url }) => {
        swatch.style.backgroundImage = `url("${url}")`;
      }, () => {}).finally(() => swatch.classList.add("painted"));
      item.append(swatch);
      return item;
    }),
  );
  mark();
}

/** Whom to name, in a list of one text or none. */
function creditOf({ authors, source, doi, photo, licence }) {
  const parts = [authors, source, doi && `doi ${doi}`, photo && `photo: ${photo}`, licence].filter(Boolean);
  return parts.length ? [parts.join(", ")] : [];
}

/** Speeds and forces that a texture was recorded at. */
function ranges({ trained_range: { speed, force } }) {
  const [fast, firm] = [speed.map(Math.round), force].map((ends) => ends.map((end) => Number(end.toPrecision(2))).join("–"));
  return `${fast} mm/s, ${firm} N`;
}

/** What stands on the shelf for a texture: the first of its methods. */
function listed(texture) {
  return groups.find((group) => group.includes(texture))?.[0] ?? texture;
}

function mark() {
  const mine = chosen && groups.find((group) => group.includes(chosen));
  for (const swatch of document.querySelectorAll("#textures .swatch"))
    swatch.setAttribute("aria-pressed", String(mine?.[0].id === swatch.dataset.id));
  $("compare").hidden = !mine || mine.length < 2;
  $("tune-it").hidden = !server || !chosen || Boolean(chosen.card) || chosen.method !== "foten-plus";
}

/** Have a texture rendered: here, or by the server where its network is one that only that runs. */
async function ready(texture) {
  if (!sound.infos.has(texture.id)) {
    const bytes = await texture.bytes, card = cardOf(bytes), { speed, force } = card.trained_range;
    if (!card.hasGraph) await sound.load(texture.id, bytes);
    else if (!server || texture.card) throw new Error(`${texture.title} is rendered by a server alone: foten serve ${texture.file}`);
    else sound.know(texture.id, { accelerationSd: card.scaling.sd[0], trainedSpeed: speed, trainedForce: force, elsewhere: true });
  }
  if (sound.infos.get(texture.id).elsewhere && !sound.server) await settings.render("stream");
  if (texture.card && sound.server) {
    await settings.render(""); // a file that was opened here does not leave this page
    say(`${texture.title} is rendered in this page: the server does not have it.`);
  }
}

/** Put a texture under the pen; its sound follows where it plays already. */
async function use(texture) {
  const another = chosen !== texture;
  chosen = texture;
  hush();
  mark();
  if (another && tune.shown) $("tune-it").hidden || blind ? tuning(false) : tune.fill();
  const info = paint(blind ? listed(texture) : texture).then(({ canvas, mm, took }) => {
    if (chosen !== texture) return;
    pad.setTile(canvas, mm);
    settings.took = took;
  });
  $("now-name").textContent = blind ? "Compare blind" : texture.title;
  if (sound.node) {
    await ready(texture);
    if (chosen !== texture) return;
    sound.use(texture.id);
    about(await texture.bytes);
    showUnit();
  }
  await info;
}

/** Say where what plays was learned, or from what it was made, and whom to name. */
function about(bytes) {
  const card = cardOf(bytes);
  $("now-range").textContent = blind ? "" : [card.evidence || `learned at ${ranges(card)}`, ...creditOf(card)].join(" · ");
}

/** What is drawn is what is rendered: acceleration, or an actuator's drive. */
function showUnit() {
  const drive = settings.actuator?.unit;
  $("acceleration-name").textContent = drive ? "drive" : "acceleration";
  $("acceleration-unit").textContent = drive ?? (chosen?.relative ? "× its RMS" : "m/s²");
}

sound.addEventListener("unit", showUnit);

// Sound

let begun = false;

async function begin() {
  if (begun && sound.running) return;
  $("begin").hidden = true;
  $("press").hidden = false;
  await sound.start();
  monitor.listen(sound.context.sampleRate, sound.analyser, sound.output);
  if (!begun) settings.apply();
  begun = true;
  if (chosen) await use(chosen);
}

/** Begin, and stroke by itself, so that something is heard. */
function demonstrate() {
  attempt(async () => {
    $("pad").focus({ preventScroll: true });
    await begin();
    pad.play();
  });
}

let pressed = null; // where, and on the button that says Touch: a stroke may begin on it
$("begin").addEventListener("pointerdown", (e) => {
  pressed = [e.clientX, e.clientY];
  pad.down(e);
});
$("begin").addEventListener("click", demonstrate); // by a key
$("pad").addEventListener("pointerup", (e) => {
  if (pressed && Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) < TAP_PX) demonstrate();
  pressed = null;
});
pad.dispatch = () => attempt(begin);
$("pad").addEventListener("pointerup", () => sound.context && attempt(begin)); // a finger is a tap only when it leaves
$("pad").addEventListener("pointerdown", (e) => ($("press").hidden = !sound.node || e.pointerType === "pen"));
$("force").addEventListener("input", (e) => (pad.force = Number(e.target.value)));
sound.addEventListener("report", ({ detail }) => monitor.report(detail));
sound.addEventListener("failed", ({ detail }) => say(detail));
sound.addEventListener("recorded", ({ detail }) => taken.show(detail, listed(chosen)));
$("settings").addEventListener("click", () => settings.show());

/** Show the sliders that change the texture, or hide them. */
function tuning(on) {
  $("tune-it").setAttribute("aria-pressed", String(on));
  tune.show(on);
}

$("tune-it").addEventListener("click", () => attempt(async () => {
  const on = !tune.shown;
  if (on) {
    endBlind();
    await begin();
    if (sound.server) await settings.render(""); // what is moved is rendered here
  }
  tuning(on);
}));

// Recording

$("record").addEventListener("click", () => attempt(async () => {
  await begin();
  const on = $("record").getAttribute("aria-pressed") !== "true";
  $("record").setAttribute("aria-pressed", String(on));
  $("record").setAttribute("aria-label", on ? "Stop recording" : "Record a stroke");
  $("record").title = on ? "Stop recording" : "Record a stroke";
  sound.record(on);
  const began = performance.now();
  clearInterval(timing);
  $("recorded").hidden = !on;
  const tell = () => ($("recorded").value = clock((performance.now() - began) / 1000));
  tell();
  if (on) timing = setInterval(tell, 200);
}));

let timing = null;

const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

// Comparing methods of one texture, without knowing which is which, all equally loud

const preferred = new Map(); // by the texture's title: how often each method was chosen

$("compare").addEventListener("click", () => attempt(async () => {
  if (blind) return reveal();
  await begin();
  tuning(false);
  const group = groups.find((one) => one.includes(chosen)), order = shuffled(group);
  for (const one of order) await ready(one);
  const gains = await gainsOf(order);
  if (!group.includes(chosen)) return; // another texture was chosen meanwhile
  sound.match(Object.fromEntries(gains.map((db, i) => [order[i].id, db])));
  blind = order;
  const buttons = order.map((one, i) => {
    const button = Object.assign(document.createElement("button"), { textContent: String.fromCharCode(65 + i) });
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => {
      for (const other of buttons) other.setAttribute("aria-checked", String(other === button));
      choose.textContent = `Choose ${button.textContent}`;
      attempt(() => use(one));
    });
    return button;
  });
  const choose = Object.assign(document.createElement("button"), { className: "choose" });
  choose.addEventListener("click", () => reveal(chosen));
  const question = Object.assign(document.createElement("span"), { textContent: "More like the surface?" });
  $("blind").replaceChildren(question, ...buttons, choose);
  $("blind").hidden = false;
  buttons[0].click();
}));

/** Return dB that make methods equally loud; the server knows those that only it renders. */
async function gainsOf(order) {
  if (!order.some((one) => sound.infos.get(one.id).elsewhere)) return asked({ do: "gains", bytes: await Promise.all(order.map((one) => one.bytes)) });
  if (order.some((one) => one.card)) throw new Error("a file that was opened here cannot be compared with one that the server renders");
  const answer = await fetch(`gains?${new URLSearchParams(order.map((one) => ["texture", one.file]))}`);
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return (await answer.json()).gains_db;
}

function endBlind() {
  if (!blind) return;
  blind = null;
  sound.match({});
  $("blind").replaceChildren();
  $("blind").hidden = true;
}

/** Say which method is which, and, once one was chosen, how often each has been. */
async function reveal(choice = null) {
  const order = blind, named = (one) => (order.some((other) => other !== one && other.method === one.method) ? one.file : one.method || one.file);
  const tally = preferred.get(choice?.title) ?? new Map(order.map((one) => [named(one), 0]));
  if (choice) preferred.set(choice.title, tally.set(named(choice), (tally.get(named(choice)) ?? 0) + 1));
  endBlind();
  await use(listed(chosen));
  const which = order.map((one, i) => `${String.fromCharCode(65 + i)} was ${named(one)}`).join(", ");
  say(choice ? `${which}. Chosen so far: ${[...tally].map(([name, n]) => `${name} ${n}×`).join(", ")}` : which);
}

function shuffled(list) {
  const order = [...list];
  for (let i = order.length - 1; i > 0; i--) {
    const j = Math.floor(Math.random() * (i + 1));
    [order[i], order[j]] = [order[j], order[i]];
  }
  return order;
}

// Files of one's own

async function open(files) {
  for (const file of files) {
    let texture;
    try {
      texture = await textureOf(file);
      if (texture.card.hasGraph) throw new Error(`its network is rendered by a server alone: foten serve ${file.name}`);
      await pictureOf(texture); // which proves it
    } catch (error) {
      throw new Error(`${file.name} was refused: ${error.message}`);
    }
    endBlind();
    textures.push(texture);
    shelve();
    await use(texture);
  }
}

$("file").addEventListener("change", (e) => attempt(() => open([...e.target.files]).finally(() => (e.target.value = ""))));
$("open").addEventListener("click", () => $("file").click());
let over = 0;
addEventListener("dragenter", (e) => (e.preventDefault(), ($("drop").hidden = ++over === 0)));
addEventListener("dragleave", () => ($("drop").hidden = --over <= 0));
addEventListener("dragover", (e) => e.preventDefault());
addEventListener("drop", (e) => {
  e.preventDefault();
  over = 0;
  $("drop").hidden = true;
  attempt(() => open([...e.dataTransfer.files]));
});

// A surface of one's own

const capture = new Capture($("capture"), { calibration: () => settings.calibration, onTexture: learned, canTrain: () => server, say });

/** A texture that the server learned from a capture: on the shelf and under the pen at once, and again when it is better. */
function learned(listed, done) {
  const texture = new Texture(listed), at = textures.findIndex((one) => one.file === texture.file), known = textures[at];
  if (known) textures[at] = texture;
  else textures.push(texture);
  pictures.delete(texture.id);
  sound.drop(texture.id);
  shelve();
  attempt(async () => {
    if (!known || chosen === known) await use(texture);
    say(done ? `${texture.title} is learned.` : `${texture.title} is there: stroke it. It may get better yet.`);
  });
}

$("capture-one").addEventListener("click", () => (cannotTrain ? say(cannotTrain) : capture.show()));

let silent = null;

/** Say something for people, for a few seconds. */
function say(text) {
  $("message").textContent = text;
  $("message").hidden = false;
  clearTimeout(silent);
  silent = setTimeout(hush, 7000);
}

function hush() {
  $("message").hidden = true;
}

async function attempt(what) {
  try {
    await what();
  } catch (error) {
    say(error.message);
  }
}

await attempt(async () => {
  const found = await shipped();
  ({ textures, server, cannotTrain } = found);
  settings.offer(server);
  $("capture-one").hidden = !server && !cannotTrain; // nobody would learn from it
  shelve();
  if (textures.length) await use(textures[0]);
});
document.documentElement.dataset.ready = "true";
window.studio = { capture, monitor, pad, sound }; // for tests and the curious
