// Plays what a server renders, and knows of nothing else: a page of a study has neither a texture nor the kernel.
import { limited, Stream } from "./stream.js";

class Player extends AudioWorkletProcessor {
  constructor() {
    super();
    this.stream = new Stream();
    this.port.onmessage = ({ data }) => (data.afresh ? (this.stream = new Stream()) : this.stream.take(data));
  }

  process(_inputs, [[out]]) {
    const before = this.stream.lacking;
    this.stream.fill(out);
    if (this.stream.lacking > before) this.port.postMessage({ underrun: true });
    for (let i = 0; i < out.length; i++) out[i] = limited(out[i]);
    return true;
  }
}

registerProcessor("foten-player", Player);
