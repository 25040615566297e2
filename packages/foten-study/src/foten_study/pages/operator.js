// The operator's page: who is where, which sample to lay down, and a hand on the trials. It is told nothing of methods; the data that it downloads name them.
const $ = (id) => document.getElementById(id);
const KINDS = { consent: "reads the consent", questions: "answers questions", instructions: "reads the instructions", break: "has a break", end: "has finished" };
let socket, hiding, invited = null, link = "";

function say(text) {
  clearTimeout(hiding);
  $("message").textContent = text;
  $("message").hidden = !text;
  hiding = setTimeout(() => ($("message").hidden = true), 7000);
}

function connect() {
  socket = new WebSocket(new URL("operate", location.href.replace(/^http/, "ws")));
  socket.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    if (message.refused) say(message.refused);
    else if (message.started) invite(message);
    else show(message);
  };
  socket.onopen = () => ($("begin-one").disabled = false); // a press before would be lost
  socket.onclose = () => {
    $("begin-one").disabled = true;
    say("No connection to the server; this page tries again.");
    setTimeout(connect, 1000);
  };
}

const counted = (n, what) => `${n} ${what}${n === 1 ? "" : what.endsWith("ch") ? "es" : "s"}`;
const ask = (message) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));

function show({ title, planned, simulated, operator, screens, real_checked: realChecked, sessions, link: newest, noise_ended: noiseEnded }) {
  if (newest !== link && invited && $("invite").open) invite({ ...invited, screens }); // a link lets one device in
  link = newest;
  const asked = invited && sessions.find((one) => one.number === invited.started), wanted = screens ?? 1;
  if (asked && asked.pages.length < wanted) invited.waits = true;
  else if (asked && invited.waits) {
    invited.waits = false;
    $("invite").close(); // whoever was waited for is there
  }
  $("title").textContent = title;
  document.title = `Operator: ${title}`;
  $("simulated").hidden = !simulated;
  if (noiseEnded && $("message").hidden) say("The masking noise has ended: look after its sound card, and start the study again.");
  const ended = sessions.filter((one) => one.kind === "end").length;
  $("count").value = `${ended} of ${planned} have finished`;
  $("none").hidden = sessions.length > 0;
  $("data").hidden = !sessions.some((one) => one.n > 0);
  $("lets-go").hidden = !operator;
  $("unchecked").hidden = realChecked || !sessions.some((one) => one.real_side !== "none");
  // Those at work first; who has finished stays below.
  const order = [...sessions].sort((a, b) => (a.kind === "end") - (b.kind === "end") || b.number - a.number);
  const known = new Map([...$("people").children].map((row) => [row.dataset.code, row])); // a number may be given twice
  for (const [code, row] of known) if (!sessions.some((one) => one.code === code)) row.remove();
  order.forEach((one, i) => {
    const row = known.get(one.code) ?? newRow(one, screens), there = $("people").children[i];
    fill(row, one);
    if (there !== row) $("people").insertBefore(row, there ?? null); // a row that is moved loses the focus and a press on it
  });
}

function newRow(one, screens) {
  const row = document.createElement("li");
  row.dataset.code = one.code;
  row.innerHTML = `<div class="who"></div><div class="now"><strong></strong><span></span></div><div class="do"></div><progress max="1"></progress>`;
  const button = (name, what) => {
    const element = Object.assign(document.createElement("button"), { className: "plain", type: "button", textContent: name });
    element.dataset.what = name;
    element.addEventListener("click", what);
    row.querySelector(".do").append(element);
  };
  button("Allow", () => ask({ do: "allow", number: one.number, request: Number(row.dataset.asks) }));
  button("Refuse", () => ask({ do: "refuse", number: one.number, request: Number(row.dataset.asks) }));
  button("Go", () => ask({ do: "go", number: one.number }));
  button("Hold", () => ask({ do: "hold", number: one.number }));
  button("Real", () => ask({ do: "side", number: one.number, side: "real" }));
  button("Virtual", () => ask({ do: "side", number: one.number, side: "virtual" }));
  button("Code", () => invite({ started: one.number, code: one.code, screens }));
  const asked = `Return the place of participant ${one.number}, ${one.code}? The next participant gets its order of trials.`;
  button("Return place", () => confirm(asked) && ask({ do: "return", code: one.code }));
  return row;
}

function fill(row, one) {
  const who = row.querySelector(".who"), small = document.createElement("small");
  small.textContent = one.code;
  who.replaceChildren(String(one.number), small);
  const trial = one.kind === "trial";
  row.querySelector("strong").textContent = trial ? `${one.texture}${one.real ? `: ${one.real}` : ""}` : KINDS[one.kind];
  const facts = [trial && (one.practice ? "practice" : `trial ${one.n + 1} of ${one.of}`), trial && (one.held ? "held" : `on the ${one.side} surface, ${counted(one.switches, "switch")}`)];
  if (one.n_missed !== undefined) facts.push(`${counted(one.n_missed, "block")} late, ${counted(one.n_underruns, "under-run")}`);
  const away = !one.pages.length && one.kind !== "end";
  if (one.n_unsaved) facts.unshift(`the disk is full: ${counted(one.n_unsaved, "event")} of the pen still to be written`);
  if (one.trouble) facts.unshift(one.trouble);
  const asks = one.asks && `another device asks to go on: request ${one.asks}`;
  row.dataset.asks = one.asks ?? "";
  row.querySelector("span").textContent = [asks, ...(away ? ["no page is connected"] : facts)].filter(Boolean).join(" · ");
  row.querySelector("span").classList.toggle("away", away || Boolean(one.n_unsaved || one.trouble || one.asks));
  row.querySelector("progress").value = one.n / one.of;
  for (const button of row.querySelectorAll("[data-what]")) {
    const { what } = button.dataset;
    if (["Allow", "Refuse"].includes(what)) button.hidden = !one.asks;
    else if (what === "Return place") button.hidden = one.answered;
    else button.hidden = one.kind === "end" || (what !== "Code" && !trial) || (what === "Go" && !one.held) || (what === "Hold" && one.held) || (["Real", "Virtual"].includes(what) && (one.held || one.real_side === "none" || what.toLowerCase() === one.side));
  }
}

function invite({ started, code, screens }) {
  invited = { started, code, waits: invited?.started === started && invited.waits };
  $("invited").textContent = `Participant ${started}`;
  $("invite-code").textContent = code;
  const roles = (screens ?? 1) > 1 ? [["stroke", "Tablet to stroke on"], ["answer", "Screen to answer on"]] : [["all", ""]];
  $("invite-codes").replaceChildren(
    ...roles.map(([role, name]) => {
      const figure = document.createElement("figure"), image = Object.assign(new Image(), { src: `codes/${code}.svg?role=${role}&at=${Date.now()}`, alt: `Code to scan for participant ${started}` });
      const caption = Object.assign(document.createElement("figcaption"), { textContent: name });
      figure.append(image, caption);
      return figure;
    }),
  );
  if (!$("invite").open) $("invite").showModal();
}

$("begin-one").addEventListener("click", () => ask({ do: "begin" }));
connect();
document.documentElement.dataset.ready = "true";
