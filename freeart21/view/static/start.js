/* Starts every section, with the data inside it or those of the page's data script; then follows the address:
 * #frame=40&state=0.8&picture=depth&parts=beside */

(async () => {
  const bus = FreeArt.makeBus();
  const sections = [...document.querySelectorAll("section[data-kind]")];
  let packed = {};
  if (typeof FreeArtPacked !== "undefined") {
    if (typeof DecompressionStream === "undefined") {
      for (const section of sections)
        section.prepend(FreeArt.element("p", { class: "notice" }, "Video and 3D view need a browser of 2023 or newer; all numbers are below."));
      return;
    }
    packed = await FreeArt.unpack(FreeArtPacked);
  }
  for (const table of document.querySelectorAll("table.sortable")) FreeArt.sortable(table);
  for (const section of sections) {
    const own = section.querySelector('script[type="application/json"]');
    const data = { ...packed[section.dataset.kind], ...JSON.parse(own?.textContent ?? "{}") };
    FreeArt.kinds[section.dataset.kind](section, data, bus);
  }
  const go = () => {
    const link = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    if (link.frame && Number.isFinite(Number(link.frame))) bus.show(Math.round(Number(link.frame)));
    bus.follow(link);
  };
  addEventListener("hashchange", go);
  go();
  document.documentElement.dataset.ready = "yes";
})();
