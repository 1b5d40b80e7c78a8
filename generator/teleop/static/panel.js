// Buttons and status display.

const $ = (id) => document.getElementById(id);
const STEPS = 1000; // of the slider
const NOTICE_MS = 6000;

const minutes = (s) => `${Math.floor(s / 60)}:${(s % 60).toFixed(1).padStart(4, "0")}`;

export class Panel {
  constructor({ hand, link, may }) {
    Object.assign(this, { hand, link, may });
    this._notice = 0;
    const click = (id, f) => $(id).addEventListener("click", f);
    click("record", () => link.do(link.status && link.status.recording ? "pause" : "record"));
    click("undo", () => link.do("undo"));
    click("save", () => link.do("save"));
    click("reset", () => {
      const take = link.status && link.status.samples >= 2;
      if (!take || confirm("Drop the take that is not saved?")) link.do("reset");
    });
    click("drive", () => link.do("drive"));
    $("slider").addEventListener("input", () => {
      const [low, high] = hand.limits;
      if (this.may()) hand.set(hand.position, hand.quaternion, low + ($("slider").value / STEPS) * (high - low), this._sliding);
      this.joint();
    });
    this._sliding = "mouse";
    $("slider").addEventListener("pointerdown", (e) => (this._sliding = e.pointerType === "touch" ? "touch" : "mouse"));
    $("slider").addEventListener("keydown", () => (this._sliding = "keys"));
    addEventListener("keydown", (event) => {
      if (event.key === "?" || event.key === "Escape") $("help").open = event.key === "?" && !$("help").open;
    });
    link.on("hello", (hello) => this._hello(hello));
    link.on("status", (status) => this._status(status));
    link.on("state", () => this.veil());
    setInterval(() => this._rates(), 250);
    this.veil();
  }

  /** Show the joint state. */
  joint() {
    const { state, limits } = this.hand;
    const [low, high] = limits;
    const share = high > low ? (state - low) / (high - low) : 0;
    if (document.activeElement !== $("slider") || Math.abs($("slider").value / STEPS - share) > 1.5 / STEPS) {
      $("slider").value = String(Math.round(share * STEPS));
    }
    const turns = !this.link.hello || this.link.hello.joint_type === "revolute";
    $("state").value = turns ? `${((state * 180) / Math.PI).toFixed(1)}°` : `${(state * 100).toFixed(2)} cm`;
  }

  /** The text over the picture while there is no picture or no connection. */
  veil() {
    const { link } = this;
    const ready = link.status && link.status.ready;
    let text = "";
    if (link.state === "lost") {
      const wait = Math.max(0, Math.ceil((link.retryAt - performance.now()) / 1000));
      const more = link.failures > 4 ? " If the server was started anew, open the address that it printed." : "";
      text = `Connection lost; recording is paused. Trying again${wait > 1 ? ` in ${wait} s` : ""}.${more}`;
    } else if (link.state === "connecting") text = "Connecting";
    else if (!ready) text = "The simulator starts";
    $("veil").hidden = !text;
    $("veil").classList.toggle("over", this._shown === true);
    $("veil-text").textContent = text;
    if (link.state !== "open") $("drive").hidden = true;
    document.body.classList.toggle("watching", Boolean(link.hello) && !link.drives);
    $("picture").classList.toggle("still", !link.drives);
  }

  /** Note that a picture was shown. */
  shown() {
    this._shown = true;
  }

  _hello(hello) {
    $("object").textContent = hello.object;
    document.title = `${hello.object} · Teleoperation · FreeArt-21`;
    $("joint").textContent = hello.joint;
    $("joint").title = hello.joint;
    this._notice = -1;
    this.joint();
    this.veil();
  }

  _status(status) {
    const drives = this.link.drives;
    const recording = status.recording, paused = status.paused;
    $("recording").hidden = !(recording || paused);
    $("recording").classList.toggle("paused", paused);
    $("clock").value = minutes(status.seconds);
    $("record").classList.toggle("on", recording);
    $("record").lastElementChild.textContent = recording ? "Pause" : paused ? "Go on" : "Record";
    $("save").disabled = !(status.samples >= 2);
    $("save").classList.toggle("ready", paused && status.samples >= 2);
    $("save").title = `Write the take to ${status.file} (Enter)`;
    $("drive").hidden = drives || status.driven;
    $("watchers").hidden = !status.watchers && drives;
    $("watchers").textContent = drives ? `${status.watchers} watching` : status.driven ? "you watch" : "nobody drives";
    if (!drives) {
      this.hand.state = status.state;
      this.joint();
    }
    if (status.notice_n !== this._notice) {
      if (status.notice && this._notice !== -1) this.say(status.notice, status.alarm);
      else if (status.notice && status.alarm) this.say(status.notice, true);
      this._notice = status.notice_n;
    }
    this.veil();
  }

  /** Show a line for some time; an alarm until the next one. */
  say(text, alarm = false) {
    const notice = $("notice");
    clearTimeout(this._fade);
    notice.textContent = text.charAt(0).toUpperCase() + text.slice(1);
    notice.hidden = false;
    notice.classList.remove("fading");
    notice.classList.toggle("alarm", alarm);
    if (!alarm) this._fade = setTimeout(() => notice.classList.add("fading"), NOTICE_MS);
  }

  _rates() {
    const fps = this.link.fps();
    $("fps").value = fps > 1 ? `${fps} fps` : "still";
    if (this.link.state === "lost") this.veil();
  }
}
