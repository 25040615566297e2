// One capture: what comes in, what the server is sent of it, and the files that it is saved to.
import { save, wavOf } from "./stroke.js";

/** One capture: its sound, its events and its socket, until the server has learned a texture from it or refuses. */
export class CaptureSession {
  /** `about` is what the server is told of it; `onSaid(this, said)` is given its answers, `onFailed(this, why)` why no more follow. */
  constructor(about, onSaid, onFailed) {
    Object.assign(this, { about, onSaid, onFailed, pieces: [], events: [], unsent: [], socket: null, recording: true, playable: false, nSamples: 0 });
    this.started = performance.now() / 1000;
  }

  get seconds() {
    return this.nSamples / this.about.rate_hz;
  }

  connect() {
    const socket = (this.socket = new WebSocket(new URL("capture", location.href.replace(/^http/, "ws"))));
    let opened = false;
    socket.onopen = () => {
      opened = true;
      for (const message of this.unsent.splice(0)) socket.send(message);
    };
    socket.onmessage = ({ data }) => this.answered(JSON.parse(data));
    socket.onclose = ({ reason }) => this.fail(opened ? reason || "the server is gone" : "the server cannot be reached");
    this.send(JSON.stringify({ do: "begin", ...this.about }));
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.CONNECTING) this.unsent.push(message);
    else this.socket?.send(message);
  }

  /** Send numbers, after the letter that says what they are. */
  sendNumbers(kind, values) {
    const bytes = new Uint8Array(1 + values.byteLength);
    bytes[0] = kind.charCodeAt(0);
    bytes.set(new Uint8Array(values.buffer, values.byteOffset, values.byteLength), 1);
    this.send(bytes);
  }

  addSound(piece) {
    this.pieces.push(piece);
    this.nSamples += piece.length;
    this.sendNumbers("s", piece);
  }

  addEvent(x, y, pressure, t) {
    this.events.push([x, y, pressure, t]);
    this.sendNumbers("e", Float64Array.of(x, y, pressure, t));
  }

  train() {
    this.recording = false;
    this.send(JSON.stringify({ do: "train" }));
  }

  answered(said) {
    if (said.refused) return this.fail(said.refused);
    if (said.playable) this.playable = true;
    if (said.done) this.end();
    this.onSaid(this, said);
  }

  /** Take nothing in any more, and leave the server; sound and events stay. */
  end() {
    const { socket } = this;
    this.recording = false;
    this.socket = null;
    if (!socket) return;
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
  }

  fail(why) {
    this.end();
    this.onFailed(this, why);
  }

  /** Save the files that `foten import sound.wav --pen pen.csv` reads, and return how many events came late. */
  save() {
    const samples = new Float32Array(this.nSamples);
    let at = 0;
    for (const piece of this.pieces) {
      samples.set(piece, at);
      at += piece.length;
    }
    save(wavOf(samples, this.about.rate_hz), "sound.wav");
    const { events, nLate } = inOrder(this.events);
    const rows = events.map(([x, y, pressure, t]) => [t, x, y, pressure].map((value) => value.toFixed(6)).join(","));
    save(new Blob([["t [s],x [mm],y [mm],pressure", ...rows, ""].join("\n")], { type: "text/csv" }), "pen.csv");
    return nLate;
  }
}

/** Return events with increasing times, and how many came late: as `in_order` of the server, which says why. */
export function inOrder(events) {
  const kept = [];
  let latest = -Infinity, nLate = 0, wasDown = false;
  for (const [x, y, pressure, t] of events) {
    const time = Number(t.toFixed(6)), turns = pressure > 0 !== wasDown;
    wasDown = pressure > 0;
    if (time < latest) nLate++;
    if (time < latest && !turns) continue;
    latest = Math.max(latest, time);
    if (kept.at(-1)?.[3] === latest) kept.pop();
    kept.push([x, y, pressure, latest]);
  }
  return { events: kept, nLate };
}
