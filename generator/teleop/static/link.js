// The websocket: sends moves, receives pictures. It reconnects by itself and queues neither.

const STEP_MS = 1000 / 60;
const KEEP_ALIVE_MS = 1000 / 30;
const MOST_WAITING = 1 << 14; // bytes that the network has not taken; a move that waits would only be late
const FIRST_WAIT_MS = 250, LONGEST_WAIT_MS = 5000;

export class Link {
  constructor(token) {
    this.hello = null;
    this.status = null;
    this.state = "connecting"; // or "open", "lost"
    this.retryAt = 0;
    this.failures = 0;
    this.immersive = false; // in a headset, where the page itself may count as hidden
    this.tap = null; // told of every move that is sent
    this._token = token;
    this._listeners = { picture: [], status: [], hello: [], place: [], state: [] };
    this._hand = null;
    this._n = 0;
    this._dirty = false;
    this._lastSent = -Infinity;
    this._seen = 0;
    this._decoding = false;
    this._next = null;
    this._arrivals = [];
    setInterval(() => this._keepAlive(), KEEP_ALIVE_MS);
    this._connect();
  }

  /** Call `f` for each "picture", "status", "hello", "place" or change of "state". */
  on(what, f) { this._listeners[what].push(f); }

  get drives() { return this.hello !== null && this.hello.role === "driver" && this.state === "open"; }

  /** Send the changed pose, now or with the next step: at most 60 a second, but every one with its own `time`, ms. */
  send(hand, device, time = null) {
    this._hand = hand;
    this._device = device;
    this._dirty = true;
    if (time === null) this.flush();
    else this._transmit(time);
  }

  /** Send the pending move. */
  flush() {
    if (this._dirty && performance.now() - this._lastSent >= STEP_MS - 1.5) this._transmit();
  }

  /** Send a command: record, pause, undo, save, reset, drive. */
  do(what) {
    if (!this.drives && what !== "drive") return;
    if (this._dirty) this._transmit();
    this._say({ type: "do", what, n: this._n });
  }

  /** Number of pictures in the last second. */
  fps() {
    const now = performance.now();
    this._arrivals = this._arrivals.filter((t) => now - t < 1000);
    return this._arrivals.length;
  }

  _transmit(time = performance.now()) {
    if (!this.drives || !this._hand || this._socket.bufferedAmount > MOST_WAITING) return;
    const hand = this._hand;
    this._n += 1;
    const move = {
      type: "move", n: this._n, time, epoch: hand.epoch, position: hand.position,
      quaternion: hand.quaternion, state: hand.state, device: this._device,
    };
    this._say(move);
    if (this.tap) this.tap(move);
    this._lastSent = performance.now();
    this._dirty = false;
  }

  _keepAlive() {
    if (this.status && this.status.recording && performance.now() - this._lastSent >= KEEP_ALIVE_MS - 2) this._transmit();
  }

  _say(message) {
    if (this._socket && this._socket.readyState === WebSocket.OPEN) this._socket.send(JSON.stringify(message));
  }

  _tell(what, ...given) {
    for (const f of this._listeners[what]) f(...given);
  }

  _become(state) {
    this.state = state;
    this._tell("state", state);
  }

  _connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws?token=${encodeURIComponent(this._token)}&v=1`);
    socket.binaryType = "arraybuffer";
    this._socket = socket;
    socket.onopen = () => { this._n = this._seen = 0; };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") this._read(JSON.parse(event.data));
      else this._picture(event.data);
    };
    socket.onclose = () => {
      this.failures += 1;
      const wait = Math.min(FIRST_WAIT_MS * 1.6 ** (this.failures - 1), LONGEST_WAIT_MS) * (0.8 + 0.4 * Math.random());
      this.retryAt = performance.now() + wait;
      this._become("lost");
      setTimeout(() => this._connect(), wait);
    };
  }

  _read(message) {
    if (message.type === "hello") {
      this.hello = message;
      this.failures = 0;
      this._become("open");
    }
    if (message.type === "status") this.status = message;
    else this._dirty = false; // the server has placed the object
    this._tell(message.type, message);
  }

  _picture(jpeg) {
    this._arrivals.push(performance.now());
    if (this._next) this._disposed();
    this._next = { jpeg, from: this._socket };
    this._decode();
  }

  async _decode() {
    if (this._decoding || !this._next) return;
    this._decoding = true;
    const { jpeg, from } = this._next;
    this._next = null;
    try {
      const bitmap = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
      this._tell("picture", bitmap);
      bitmap.close();
      if (from === this._socket) this._disposed();
    } finally {
      this._decoding = false;
    }
    this._decode();
  }

  _disposed() {
    this._seen += 1;
    this._say({ type: "seen", n: this._seen });
  }
}
