// The 3D player of plan.html: an arm's collision shapes, moved through a plan; play, pause, scrub, jump to where it is closest to the cell
// and to itself.
// Everything it shows comes from <script type="application/json" id="scene">; nothing is fetched.
import {
  AmbientLight, BoxGeometry, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide,
  Float32BufferAttribute, FrontSide, GridHelper, Group, Line, LineBasicMaterial, Matrix4, Mesh, MeshStandardMaterial, PerspectiveCamera,
  PlaneGeometry, Quaternion, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const data = JSON.parse(document.getElementById("scene").textContent);
const root = document.getElementById("player");
const find = (name) => root.querySelector(`[data-part=${name}]`);
const [view, play, scrub, clock, speed, choice, closest, distance] =
  ["view", "play", "scrub", "clock", "speed", "motion", "closest", "distance"].map(find);

function colour(name) {
  return new Color(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
}

function placed(object, rotation, position) {
  const r = rotation;
  const m = new Matrix4().set(
    r[0][0], r[0][1], r[0][2], position[0], r[1][0], r[1][1], r[1][2], position[1],
    r[2][0], r[2][1], r[2][2], position[2], 0, 0, 0, 1);
  m.decompose(object.position, object.quaternion, object.scale);
  return object;
}

// Capsules and cylinders lie along z as MuJoCo has them; three.js draws them along y.
function solid(shape) {
  const s = shape.size;
  if (shape.kind === "box") return new BoxGeometry(2 * s[0], 2 * s[1], 2 * s[2]);
  if (shape.kind === "sphere") return new SphereGeometry(s[0], 24, 16);
  if (shape.kind === "capsule") return new CapsuleGeometry(s[0], 2 * s[1], 8, 24).rotateX(Math.PI / 2);
  if (shape.kind === "cylinder") return new CylinderGeometry(s[0], s[0], 2 * s[1], 32).rotateX(Math.PI / 2);
  if (shape.kind === "plane") return new PlaneGeometry(s[0], s[0]);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(shape.vertices.flat(), 3));
  geometry.setIndex(shape.faces.flat());
  geometry.computeVertexNormals();
  return geometry;
}

const scene = new Scene();
const links = data.links.map((link) => {
  const joint = placed(new Group(), link.rotation, link.position);
  const moving = new Group();
  joint.add(moving);
  return { joint, moving, axis: new Vector3(...link.axis), prismatic: link.prismatic };
});
data.links.forEach((link, k) => (link.parent < 0 ? scene : links[link.parent].moving).add(links[k].joint));

const painted = [];
const bodies = []; // name and material of every shape
const heated = []; // material, role and joint of every shape of a moving link
function paint(object, role) {
  painted.push([object.material, role]);
  return object;
}
for (const shape of data.shapes) {
  const obstacle = shape.link === null;
  const material = new MeshStandardMaterial({
    roughness: 0.6, metalness: 0.1, transparent: obstacle, opacity: obstacle ? 0.25 : 1, side: obstacle ? DoubleSide : FrontSide,
  });
  const body = placed(new Mesh(solid(shape), material), shape.rotation, shape.position);
  const role = obstacle ? "accent" : shape.link < 0 ? "muted" : shape.link % 2 ? "link-odd" : "link-even";
  paint(body, role);
  bodies.push([shape.name, material]);
  if (!obstacle && shape.link >= 0) heated.push([material, role, shape.link]);
  (obstacle || shape.link < 0 ? scene : links[shape.link].moving).add(body);
}
const grid = new GridHelper(data.size * 2, 20);
grid.rotation.x = Math.PI / 2;
grid.material.vertexColors = false;
scene.add(paint(grid, "grid"));
const trail = new Line(new BufferGeometry(), new LineBasicMaterial());
scene.add(paint(trail, "before"));
scene.add(new AmbientLight(0xffffff, 1.4));
for (const [x, y, z, strength] of [[2, -3, 4, 2.2], [-3, 2, 2, 0.8]]) {
  const light = new DirectionalLight(0xffffff, strength);
  light.position.set(x, y, z);
  scene.add(light);
}

const camera = new PerspectiveCamera(38, 1, 0.01, 100);
camera.up.set(0, 0, 1);
camera.position.set(1.25 * data.size, -1.7 * data.size, 1.2 * data.size);

let renderer = null;
let controls = null;
try {
  renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
} catch {
  view.textContent = "This browser has no WebGL, so the arm is not drawn in 3D. Time, curves and the closest moment still work.";
}
if (renderer) {
  view.append(renderer.domElement);
  controls = new OrbitControls(camera, renderer.domElement);
  controls.target.set(0, 0, 0.4 * data.size);
  controls.update();
  controls.addEventListener("change", draw);
}

function draw() {
  if (renderer) renderer.render(scene, camera);
}

function recolour() {
  for (const [material, role] of painted) material.color = colour(role);
  scene.background = colour("panel");
  light();
  warm();
  draw();
}

function resize() {
  if (!renderer) return;
  const [width, height] = [view.clientWidth, view.clientHeight];
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setSize(width, height, true);
  camera.aspect = width / height;
  camera.updateProjectionMatrix();
  draw();
}

let motion = data.motions[0];
let time = 0;
let playing = false;
let last = 0;
const turn = new Quaternion();

function posture(at) {
  const t = motion.t;
  let low = 0;
  let high = t.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= at) low = middle;
    else high = middle;
  }
  const part = Math.min(1, Math.max(0, (at - t[low]) / (t[high] - t[low] || 1)));
  return motion.q[low].map((value, j) => value + part * (motion.q[high][j] - value));
}

// The residual at a joint as heat on its link, where the motion brings it: 0 as painted, 1 the colour of a failure.
function warm() {
  if (!motion.heat) return;
  const t = motion.t;
  const k = Math.min(t.length - 1, Math.round((time / (t[t.length - 1] || 1)) * (t.length - 1)));
  const hot = colour("bad");
  const cold = { "link-odd": colour("link-odd"), "link-even": colour("link-even") };
  for (const [material, role, joint] of heated) material.color = cold[role].clone().lerp(hot, motion.heat[k][joint]);
}

// How far the arm is from the cell and from itself at this moment, each by itself.
function measure() {
  const k = Math.round((time / (motion.t[motion.t.length - 1] || 1)) * (motion.t.length - 1));
  const near = (motion.near || []).map((n) => `to ${n.to} ${(1000 * n.distance[k]).toFixed(0)} mm`);
  distance.textContent = near.length ? `distance ${near.join(" · ")}` : "";
}

// The two bodies that come closest shine at that moment.
function light() {
  const lit = (motion.near || []).filter((n) => Math.abs(time - n.at) <= 0.05).flatMap((n) => n.pair);
  for (const [name, material] of bodies) {
    if (lit.includes(name)) material.emissive = colour("bad");
    else material.emissive.setRGB(0, 0, 0);
  }
  view.dataset.lit = lit.join(" ");
}

function show(at, told = true) {
  time = Math.min(motion.t[motion.t.length - 1], Math.max(0, at));
  const q = posture(time);
  links.forEach((link, j) => {
    if (link.prismatic) link.moving.position.copy(link.axis).multiplyScalar(q[j]);
    else link.moving.quaternion.copy(turn.setFromAxisAngle(link.axis, q[j]));
  });
  scrub.value = String(time);
  clock.textContent = `${time.toFixed(2)} / ${motion.t[motion.t.length - 1].toFixed(2)} s`;
  scrub.setAttribute("aria-valuetext", clock.textContent);
  for (const head of document.querySelectorAll(`[data-motion="${motion.name}"] .playhead`)) {
    const { x0, x1, t0, t1 } = head.dataset;
    const x = +x0 + ((time - t0) / (t1 - t0)) * (x1 - x0);
    head.setAttribute("x1", x);
    head.setAttribute("x2", x);
  }
  measure();
  light();
  warm();
  draw();
  if (told) document.dispatchEvent(new CustomEvent("calib-time", { detail: { motion: motion.name, time } }));
}

function choose(name) {
  motion = data.motions.find((m) => m.name === name);
  scrub.max = String(motion.t[motion.t.length - 1]);
  trail.geometry.dispose();
  trail.geometry = new BufferGeometry();
  trail.geometry.setAttribute("position", new Float32BufferAttribute(motion.trail.flat(), 3));
  for (const part of document.querySelectorAll("[data-motion]")) part.hidden = part.dataset.motion !== name;
  closest.replaceChildren(...(motion.near || []).map((n) => {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: `closest to ${n.to}` });
    button.addEventListener("click", () => { pause(); show(n.at); });
    return button;
  }));
  pause();
  show(0);
}

function frame(now) {
  if (!playing) return;
  show(time + ((now - last) / 1000) * Number(speed.value));
  last = now;
  if (time >= motion.t[motion.t.length - 1]) pause();
  else requestAnimationFrame(frame);
}

function pause() {
  playing = false;
  play.textContent = "▶ play";
}

play.addEventListener("click", () => {
  if (playing) {
    pause();
    return;
  }
  if (time >= motion.t[motion.t.length - 1]) show(0);
  playing = true;
  play.textContent = "❚❚ pause";
  last = performance.now();
  requestAnimationFrame(frame);
});
scrub.addEventListener("input", () => { pause(); show(Number(scrub.value)); });
choice.addEventListener("change", () => choose(choice.value));
// the curves of a report move the arm
document.addEventListener("calib-seek", (event) => {
  if (event.detail.log !== motion.name) {
    if (!data.motions.some((m) => m.name === event.detail.log)) return;
    choice.value = event.detail.log;
    choose(event.detail.log);
  }
  pause();
  show(event.detail.time, false);
});
addEventListener("resize", resize);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
addEventListener("beforeprint", () => { for (const part of document.querySelectorAll("[data-motion]")) part.hidden = false; });
addEventListener("afterprint", () => choose(motion.name));
choose(motion.name);
resize();
recolour();
