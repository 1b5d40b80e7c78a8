/* Bring every section to life, then go where the address points: #frame=40&state=0.8&picture=depth&parts=beside */

(() => {
  const bus = FreeArt.makeBus();
  for (const section of document.querySelectorAll("section[data-kind]")) {
    const data = section.querySelector('script[type="application/json"]');
    if (data) FreeArt.kinds[section.dataset.kind]?.(section, JSON.parse(data.textContent), bus);
  }
  const go = () => {
    const link = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    if (link.frame && Number.isFinite(Number(link.frame))) bus.show(Math.round(Number(link.frame)));
    bus.follow(link);
  };
  addEventListener("hashchange", go);
  go();
})();
