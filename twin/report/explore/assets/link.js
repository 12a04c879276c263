// Connection to the server: sends requests, unpacks answers, reconnects.

const SOON = 500;
const LATEST = 4000;

/** Decode a message: JSON, or JSON followed by samples (twin/report/explore/server.py). */
export function unpackedAnswer(data) {
  if (typeof data === "string") return JSON.parse(data);
  const length = new DataView(data).getUint32(0, true);
  const answer = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  answer.samples = new Float32Array(data, 4 + length);
  return answer;
}

export class Link {
  /** `heard` is called with each answer, `changed` with whether the page is connected, and if not, whether the server
   * has forgotten it. */
  constructor(heard, changed) {
    this.heard = heard;
    this.changed = changed;
    this.number = 0;
    this.patience = SOON;
    this.open();
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}/link`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.patience = SOON;
      this.changed(true);
    };
    this.socket.onmessage = (event) => this.heard(unpackedAnswer(event.data));
    this.socket.onclose = async () => {
      this.changed(false, false);
      setTimeout(() => this.open(), this.patience);
      this.patience = Math.min(LATEST, 2 * this.patience);
      const answer = await fetch("explore.css").catch(() => null);
      if (answer?.status === 403) this.changed(false, true);
    };
  }

  /** Send a request and return its number; 0 without a connection. */
  ask(what) {
    if (this.socket.readyState !== WebSocket.OPEN) return 0;
    this.number += 1;
    this.socket.send(JSON.stringify({ ...what, id: this.number }));
    return this.number;
  }
}
