// Start of the page: moves the token from the address to the tab's storage and connects hand, link, desk and panel.

import { Desk } from "./desk.js";
import { Hand } from "./hand.js";
import { startHeadset } from "./headset.js";
import { Link } from "./link.js";
import { Panel } from "./panel.js";

const token = new URLSearchParams(location.search).get("token") || "";
history.replaceState(null, "", location.pathname);
try {
  sessionStorage.setItem("token", token); // the server's answer to a reload, which comes without it, takes it from there
} catch { /* a browser that keeps nothing: the address opens the page again */ }

const canvas = document.getElementById("picture");
const hand = new Hand();
const link = new Link(token);
const may = () => link.drives;
const desk = new Desk({ hand, link, canvas, may });
const context = canvas.getContext("2d", { alpha: false, desynchronized: true });

hand.onchange = (device, time) => {
  link.send(hand, device, time);
  panel.joint();
};
link.onhello((hello) => {
  hand.meet(hello);
  if (link.drives) link.send(hand, hand.device);
});
const panel = new Panel({ hand, link, desk, may }); // hears of the object after the hand
link.onplace((place) => {
  hand.place(place, place.epoch);
  panel.joint();
  if (link.drives) link.send(hand, hand.device);
});
link.onsize((size) => {
  hand.aspect = size.width / size.height;
  if (link.drives) hand.fit();
});
link.onpicture((bitmap) => {
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width;
    canvas.height = bitmap.height;
  }
  context.drawImage(bitmap, 0, 0);
  panel.shown();
  document.documentElement.dataset.ready = "yes";
});

function resized() {
  const ratio = window.devicePixelRatio || 1;
  link.view(canvas.clientWidth * ratio, canvas.clientHeight * ratio);
}
new ResizeObserver(resized).observe(canvas);
document.addEventListener("visibilitychange", () => {
  if (document.hidden && !link.immersive && link.drives && link.status && link.status.recording) link.do("pause");
});

function step() {
  link.flush();
  requestAnimationFrame(step);
}
requestAnimationFrame(step);

window.teleop = { hand, link, desk, panel }; // for tests, and for who is curious
window.teleop.headset = startHeadset({ hand, link, picture: canvas, button: document.getElementById("headset") });
