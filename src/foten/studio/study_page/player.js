// Plays what a server renders, and knows of nothing else: a page of a study has neither a texture nor the kernel.
import { limited, Stream } from "./stream.js";

class Player extends AudioWorkletProcessor {
  constructor() {
    super();
    this.stream = new Stream();
    this.port.onmessage = ({ data }) => this.stream.take(data);
  }

  process(_inputs, [[out]]) {
    this.stream.fill(out);
    for (let i = 0; i < out.length; i++) out[i] = limited(out[i]);
    return true;
  }
}

registerProcessor("foten-player", Player);
