// The headset comes here; until then its button stays hidden.

export function startHeadset() {}
