// Plane geometry of the things in a world. Metres; angles in degrees where they are a world file's.

export const radians = (degrees) => (degrees * Math.PI) / 180;
export const degrees = (angle) => (angle * 180) / Math.PI;
export const add = (a, b) => [a[0] + b[0], a[1] + b[1]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1]];
export const length = (a) => Math.hypot(a[0], a[1]);

/** A length as it is written: whole millimetres, unless it is none of the editor's making. */
export const millimetres = (value) => Math.round(value * 1000) / 1000 + 0;
export const rounded = (point) => point.map(millimetres);
export const snapped = (value, step) => millimetres(step ? Math.round(value / step) * step : value);

/** An angle within (-180, 180], to a tenth or to a step. */
export function turned(angle, step) {
  const wrapped = angle - 360 * Math.round(angle / 360);
  const value = step ? Math.round(wrapped / step) * step : Math.round(wrapped * 10) / 10;
  return (value <= -180 ? value + 360 : value) + 0;
}

export function rotate([x, y], angle) {
  const cos = Math.cos(angle), sin = Math.sin(angle);
  return [x * cos - y * sin, x * sin + y * cos];
}

/** Corners of a box or a polygon. */
export function corners(thing) {
  if (thing.points) return thing.points;
  const [a, b] = thing.size.map((extent) => extent / 2);
  return [[-a, -b], [a, -b], [a, b], [-a, b]].map((corner) => add(thing.at, rotate(corner, radians(thing.yaw_deg))));
}

/** Where a thing's name stands. */
export function middle(thing) {
  if (!thing.points) return thing.at;
  const count = thing.points.length;
  return [0, 1].map((axis) => thing.points.reduce((sum, point) => sum + point[axis], 0) / count);
}

export const pathOf = (thing) => (Array.isArray(thing.motion?.path) ? thing.motion.path : null);

/** The settings of a thing that is moved by a vector. */
export function moved(thing, by) {
  const shift = (point) => rounded(add(point, by));
  const values = thing.points ? { points: thing.points.map(shift) } : { at: shift(thing.at) };
  if (pathOf(thing)) values.motion = { ...settled(thing.motion), path: thing.motion.path.map(shift) };
  if (thing.motion?.hinge) values.motion = { ...settled(thing.motion), hinge: shift(thing.motion.hinge) };
  return values;
}

/** The settings of a thing that is turned by an angle about its middle, metres and degrees. */
export function turnedBy(thing, by, step) {
  if (thing.points) {
    const centre = middle(thing);
    return { points: thing.points.map((p) => rounded(add(centre, rotate(subtract(p, centre), radians(by))))) };
  }
  return { yaw_deg: turned((thing.yaw_deg ?? 0) + by, step) };
}

/** Settings without those that are not given. */
export const settled = (settings) =>
  Object.fromEntries(Object.entries(settings).filter(([, value]) => value !== null && value !== undefined));
