// Settings of this browser. A browser that keeps nothing uses the defaults.
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
