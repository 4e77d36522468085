// The depth image: colours, the reading under the mouse, and where in the plan that is.

const VIRIDIS = [
  "#fde725", "#d5e21a", "#aadc32", "#81d34d", "#5cc863", "#3dbc74", "#27ad81", "#1f9f88", "#21908d", "#26818e", "#2c718e", "#33628d", "#3b518b", "#423f85", "#472c7a", "#481769", "#440154"
].map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
const NO_RETURN = [217, 220, 224];

function colour(share) {
  const place = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const i = Math.min(Math.floor(place), VIRIDIS.length - 2), rest = place - i;
  return VIRIDIS[i].map((value, channel) => Math.round(value + rest * (VIRIDIS[i + 1][channel] - value)));
}

export class DepthView {
  /** @param onPoint called with the point of the world under the mouse, or null. */
  constructor(elements, onPoint) {
    Object.assign(this, elements);
    this.onPoint = onPoint;
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("pointerleave", () => { this.mouse = null; this.tell(); });
  }

  setCamera(camera) {
    this.camera = camera;
    const range = Math.round(camera.max_range * 1000);
    this.table = Array.from({ length: range + 1 }, (_, mm) => colour(mm / range));
    const context = this.scale.getContext("2d"), bar = context.createImageData(256, 1);
    for (let i = 0; i < 256; i++) bar.data.set([...this.shade((i / 255) * range), 255], 4 * i);
    context.putImageData(bar, 0, 0);
    this.scaleEnd.textContent = `${camera.max_range} m and more`;
  }

  shade(mm) {
    return mm < 1000 * this.camera.blind_zone ? NO_RETURN : this.table[Math.min(Math.round(mm), this.table.length - 1)];
  }

  show(depth, width, height, pose) {
    this.depth = depth;
    this.pose = pose;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const context = this.canvas.getContext("2d"), image = context.createImageData(width, height);
    let any = false;
    for (let i = 0; i < depth.length; i++) {
      const [r, g, b] = this.shade(depth[i]);
      image.data[4 * i] = r;
      image.data[4 * i + 1] = g;
      image.data[4 * i + 2] = b;
      image.data[4 * i + 3] = 255;
      any ||= depth[i] > 0;
    }
    context.putImageData(image, 0, 0);
    this.inside.hidden = any;
    this.tell();
  }

  hover(event) {
    const box = this.canvas.getBoundingClientRect();
    this.mouse = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    this.tell();
  }

  tell() {
    if (!this.mouse || !this.depth) {
      const least = this.depth ? this.depth.reduce((a, b) => Math.min(a, b), Infinity) / 1000 : null;
      this.readout.textContent = least === null ? "" : `nearest ${least.toFixed(2)} m`;
      return this.onPoint(null);
    }
    const { width, height } = this.canvas;
    const column = Math.min(Math.floor(this.mouse[0] * width), width - 1);
    const row = Math.min(Math.floor(this.mouse[1] * height), height - 1);
    const depth = this.depth[row * width + column] / 1000;
    const reach = Math.tan(((this.camera.horizontal_fov_deg / 2) * Math.PI) / 180);
    const rise = Math.tan(((this.camera.vertical_fov_deg / 2) * Math.PI) / 180);
    const left = reach * (1 - (2 * (column + 0.5)) / width), up = rise * (1 - (2 * (row + 0.5)) / height);
    const far = depth >= this.camera.max_range;
    const z = this.camera.mount_z + up * depth;
    this.readout.textContent = far ? `${this.camera.max_range} m or more`
      : depth < this.camera.blind_zone ? `${depth.toFixed(3)} m: too near for the sensor, a collision`
        : `${depth.toFixed(3)} m ahead, ${Math.max(z, 0).toFixed(2)} m above the floor`;
    const [x, y, yaw] = this.pose;
    const ahead = depth + this.camera.mount_x, aside = left * depth + this.camera.mount_y;
    this.onPoint(far ? null : [x + ahead * Math.cos(yaw) - aside * Math.sin(yaw), y + ahead * Math.sin(yaw) + aside * Math.cos(yaw)]);
  }
}
