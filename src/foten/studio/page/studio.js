// The page: textures on a shelf, one of them under the pen.
import { cardOf, grouped, shipped, Texture, textureOf } from "./shelf.js";
import { Monitor } from "./monitor.js";
import { Pad } from "./pad.js";
import { Settings } from "./settings.js";
import { PageSound } from "./sound.js";
import { Taken } from "./stroke.js";
import { Capture } from "./capture.js";

const $ = (id) => document.getElementById(id);
const sound = new PageSound();
const monitor = new Monitor({
  traces: $("traces"),
  spectrogram: $("spectrogram"),
  meter: $("meter").firstElementChild,
  numbers: { acceleration: $("acceleration"), speed: $("speed"), force: $("newtons") },
});
const pad = new Pad($("pad"), (...event) => sound.push(...event));
const settings = new Settings($("panel"), sound, pad);
const taken = new Taken($("taken"), { sound, pad, groups: () => groups, use });
const pictures = new Map(); // by a texture's id: what surface.js made
const painter = new Worker("surface.js", { type: "module" });
const painting = new Map();
let textures = [], groups = [], chosen = null, blind = null, server = false, cannotTrain = "";

// Pictures

painter.onmessage = ({ data: { id, picture, failed } }) => {
  const { resolve, reject } = painting.get(id);
  painting.delete(id);
  if (failed) return reject(new Error(failed));
  const canvas = Object.assign(document.createElement("canvas"), { width: picture.size, height: picture.size });
  canvas.getContext("2d").putImageData(new ImageData(picture.pixels, picture.size, picture.size), 0, 0);
  resolve({ ...picture, canvas, url: canvas.toDataURL("image/jpeg", 0.85) });
};

function pictureOf(texture) {
  if (!pictures.has(texture.id))
    pictures.set(
      texture.id,
      texture.bytes.then(
        (bytes) =>
          cardOf(bytes).hasGraph ? plain(cardOf(bytes)) : new Promise((resolve, reject) => {
            painting.set(texture.id, { resolve, reject });
            painter.postMessage({ id: texture.id, bytes, name: texture.name || texture.title });
          }),
      ),
    );
  return pictures.get(texture.id);
}

/** The picture of what this page cannot render. */
function plain(card) {
  const canvas = Object.assign(document.createElement("canvas"), { width: 8, height: 8 }), g = canvas.getContext("2d");
  g.fillStyle = "#77716a";
  g.fillRect(0, 0, 8, 8);
  return { canvas, mm: 24, loud: card.scaling.sd[0], url: canvas.toDataURL() };
}

async function paint(texture) {
  const picture = await pictureOf(texture);
  if (texture.photo) {
    const photo = new Image();
    photo.src = texture.photo;
    await photo.decode();
    return { ...picture, canvas: photo, url: texture.photo };
  }
  return picture;
}

// The shelf

function shelve() {
  groups = grouped(textures);
  $("textures").replaceChildren(
    ...groups.map((group) => {
      const [texture] = group, swatch = document.createElement("button"), name = document.createElement("span"), item = document.createElement("li");
      swatch.className = "swatch";
      swatch.dataset.id = texture.id;
      name.textContent = texture.title;
      swatch.append(name);
      swatch.addEventListener("click", () => attempt(async () => {
        await begin();
        await use(texture);
        if (pad.pen === null) pad.play(1.8);
      }));
      paint(texture).then(({ url }) => (swatch.style.backgroundImage = `url("${url}")`), () => {});
      item.append(swatch);
      return item;
    }),
  );
  mark();
}

function mark() {
  const mine = chosen && groups.find((group) => group.includes(chosen));
  for (const swatch of document.querySelectorAll("#textures .swatch"))
    swatch.setAttribute("aria-pressed", String(mine?.[0].id === swatch.dataset.id));
  $("compare").hidden = !mine || mine.length < 2;
}

/** Have a texture rendered: here, or by the server where its network is one that only that runs. */
async function ready(texture) {
  if (!sound.infos.has(texture.id)) {
    const bytes = await texture.bytes, card = cardOf(bytes);
    if (!card.hasGraph) return sound.load(texture.id, bytes);
    if (!server || texture.card) throw new Error(`${texture.title} is rendered by a server alone: foten serve ${texture.file}`);
    const { speed, force } = card.trained_range;
    sound.know(texture.id, { accelerationSd: card.scaling.sd[0], trainedSpeed: speed, trainedForce: force, elsewhere: true });
  }
  if (sound.infos.get(texture.id).elsewhere && !sound.server) await settings.render("stream");
}

/** Put a texture under the pen; its sound follows where it plays already. */
async function use(texture) {
  chosen = texture;
  mark();
  const info = paint(texture).then(({ canvas, mm, took }) => {
    if (chosen !== texture) return;
    pad.setTile(canvas, mm);
    settings.took = took;
  });
  $("now-name").textContent = blind ? "Compare blind" : texture.title;
  if (sound.node) {
    await ready(texture);
    if (chosen !== texture) return;
    sound.use(texture.id);
    const { trainedSpeed, trainedForce } = sound.infos.get(texture.id);
    const range = ([low, high], unit, digits) => `${low.toFixed(digits)} – ${high.toFixed(digits)} ${unit}`;
    $("now-range").textContent = `recorded at ${range(trainedSpeed, "mm/s", 0)}, ${range(trainedForce, "N", 1)}`;
    $("acceleration-unit").textContent = texture.relative ? "× its RMS" : "m/s²";
  }
  await info;
}

// Sound

async function begin() {
  if (sound.running) return;
  $("begin").hidden = true;
  $("press").hidden = false;
  const first = !sound.node;
  await sound.start();
  monitor.rate = sound.context.sampleRate;
  monitor.analyser = sound.analyser;
  if (first) settings.apply();
  if (chosen) await use(chosen);
}

$("begin").addEventListener("click", () => attempt(async () => {
  await begin();
  pad.play();
}));
pad.dispatch = () => attempt(begin);
$("pad").addEventListener("pointerup", () => sound.context && attempt(begin)); // a finger is a tap only when it leaves
$("pad").addEventListener("pointerdown", (e) => ($("press").hidden = !sound.node || e.pointerType === "pen"));
$("force").addEventListener("input", (e) => (pad.force = Number(e.target.value)));
sound.addEventListener("report", ({ detail }) => monitor.report(detail));
sound.addEventListener("failed", ({ detail }) => say(detail));
sound.addEventListener("recorded", ({ detail }) => taken.show(detail, chosen));
$("settings").addEventListener("click", () => settings.show());

// Recording

$("record").addEventListener("click", () => attempt(async () => {
  await begin();
  const on = $("record").getAttribute("aria-pressed") !== "true";
  $("record").setAttribute("aria-pressed", String(on));
  $("record").setAttribute("aria-label", on ? "Stop recording" : "Record a stroke");
  sound.record(on);
}));

// Comparing methods of one texture, without knowing which is which, all equally loud

$("compare").addEventListener("click", () => attempt(async () => {
  if (blind) return reveal();
  await begin();
  const group = groups.find((one) => one.includes(chosen));
  const order = shuffled(group), loud = await Promise.all(order.map(async (one) => (await pictureOf(one)).loud));
  for (const one of order) await ready(one);
  const scaled = order.map((one, i) => loud[i] / sound.infos.get(one.id).accelerationSd);
  sound.match(Object.fromEntries(order.map((one, i) => [one.id, 20 * Math.log10(scaled[0] / scaled[i])])));
  blind = order;
  const buttons = order.map((one, i) => {
    const button = Object.assign(document.createElement("button"), { textContent: String.fromCharCode(65 + i) });
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => attempt(async () => {
      await use(one);
      for (const other of buttons) other.setAttribute("aria-checked", String(other === button));
    }));
    return button;
  });
  const show = Object.assign(document.createElement("button"), { textContent: "Reveal" });
  show.addEventListener("click", reveal);
  $("blind").replaceChildren(...buttons, show);
  $("blind").hidden = false;
  buttons[0].click();
}));

function reveal() {
  const names = blind.map((one, i) => `${String.fromCharCode(65 + i)} ${one.method || one.file}`).join(" · ");
  blind = null;
  sound.match({});
  $("blind").hidden = true;
  say(names);
  use(chosen);
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
    textures.push(texture);
    shelve();
    await use(texture);
  }
}

$("file").addEventListener("change", (e) => attempt(() => open([...e.target.files]).finally(() => (e.target.value = ""))));
$("open").addEventListener("keydown", (e) => ["Enter", " "].includes(e.key) && $("file").click());
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

const capture = new Capture($("capture"), { calibration: () => settings.calibration, onTexture: learned, canTrain: () => server });

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
  silent = setTimeout(() => ($("message").hidden = true), 7000);
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
  shelve();
  if (textures.length) await use(textures[0]);
});
document.documentElement.dataset.ready = "true";
window.studio = { capture, monitor, pad, sound }; // for tests and the curious
