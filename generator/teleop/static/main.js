// Start of the page: connects hand, link, desk, panel and headset.

import { Desk } from "./desk.js";
import { Hand } from "./hand.js";
import { startHeadset } from "./headset.js";
import { Link } from "./link.js";
import { Panel } from "./panel.js";

const canvas = document.getElementById("picture");
const hand = new Hand();
const link = new Link(new URLSearchParams(location.search).get("token") || "");
const may = () => link.drives;
const desk = new Desk({ hand, link, canvas, may });
const context = canvas.getContext("2d", { alpha: false, desynchronized: true });

hand.onchange = (device, time) => {
  link.send(hand, device, time);
  panel.joint();
};
link.on("hello", (hello) => {
  hand.meet(hello);
  if (link.drives) link.send(hand, hand.device);
});
const panel = new Panel({ hand, link, may }); // hears of the object after the hand
link.on("place", (place) => {
  hand.place(place, place.epoch);
  panel.joint();
  if (link.drives) link.send(hand, hand.device);
});
link.on("picture", (bitmap) => {
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width;
    canvas.height = bitmap.height;
  }
  context.drawImage(bitmap, 0, 0);
  panel.shown();
  document.documentElement.dataset.ready = "yes";
});
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
