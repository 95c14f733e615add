// What outlasts a view: settings of this browser, and the address. A browser that keeps nothing uses the defaults.
export function kept(name, otherwise) {
  try {
    return localStorage.getItem(`vaoi-${name}`) ?? otherwise;
  } catch {
    return otherwise;
  }
}

export function keep(name, value) {
  try {
    localStorage.setItem(`vaoi-${name}`, value);
  } catch {
    // private windows refuse
  }
}

// State in the address what a view shows, so that a link reproduces it; `view` is its address without a query. A view that was left
// while it waited for a reply does nothing: the address is that of another view, which a reload must show again.
export function stateShown(view, query) {
  if (location.hash.split("?")[0] !== view) return;
  const stated = String(query);
  history.replaceState(null, "", `${view}${stated ? `?${stated}` : ""}`);
}
