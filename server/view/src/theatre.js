// The theatre in 3D: what the server's scenes are made of, where frames say it is.

import {
  BufferAttribute, BufferGeometry, Color, ConeGeometry, CylinderGeometry, DirectionalLight, Fog,
  Group, HemisphereLight, InstancedMesh, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, NeutralToneMapping, PCFShadowMap,
  PerspectiveCamera, PMREMGenerator, Quaternion, Raycaster, Scene, Sphere, SphereGeometry, SpotLight, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";

/** Length of the arrow of a force of 1 N, m; longer ones end at the second number. */
const ARROW = 0.014, LONGEST = 0.06;
const MOST_CONTACTS = 64;
/** Pictures that come later after each other are too slow, ms. */
const LATE = 70;
/** OpenCV's cameras look along z with y down, three.js's along −z with y up. */
const FROM_OPENCV = new Quaternion(1, 0, 0, 0);
const BACKDROP = 0x141a20, CAVITY_BACKDROP = 0x0c0404;
/** How much of the room is mirrored. */
const BENCH_GLOSS = 0.36, CAVITY_GLOSS = 0.05;
/** As bright as the lamp of the bench on what is 160 mm away, cd. */
const SCOPE_LIGHT = 1.9 * 0.16 ** 2;
/** What has a larger radius is what objects lie on, m. */
const LARGEST_OBJECT = 0.03;
/** The angle of a close view from the upper to the lower edge, rad. */
const CLOSE_VIEW = 0.7;

export class Theatre {
  camera = new PerspectiveCamera(45, 1, 0.005, 30);
  #canvas;
  #renderer;
  #scene = new Scene();
  #controls;
  #lamp = new DirectionalLight();
  /** The lamp at the endoscope. */
  #scopeLight = new SpotLight(0xffffff, SCOPE_LIGHT, 0, 1.2, 1);
  #sky = new HemisphereLight();
  #geometries = new Map();
  #materials = new Map();
  #cards = new Map();
  #parts = [];
  /** The scene whose parts are there. */
  #card = null;
  #place = "";
  #contacts = new Contacts();
  /** "overview", "close", "endoscope", or nothing where the user has the camera. */
  #view = "";
  /** Where the camera's axis is in the window, of its width and height from the middle. */
  #shift = [0, 0];
  #endoscope = null;
  #lens = new PerspectiveCamera(60, 1, 0.01, 10);
  /** A canvas that shows what the endoscope sees, or none. */
  inset = null;
  #dirty = true;
  #isSlow = drawsInSoftware();
  /** Pixels of the picture over those of the window, each way. */
  #fineness = this.#isSlow ? 0.6 : 1;
  #drawn = 0;
  #late = 0;
  /** Called with the name of another view; with none when the user takes the camera. */
  onView = () => {};
  /** What of the canvas no panel covers: left, top, right, bottom, px. */
  clearing = () => [0, 0, this.#canvas.clientWidth, this.#canvas.clientHeight];

  constructor(canvas) {
    this.#canvas = canvas;
    const renderer = new WebGLRenderer({ canvas, antialias: !this.#isSlow, powerPreference: "high-performance" });
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = PCFShadowMap;
    renderer.toneMapping = NeutralToneMapping;
    renderer.toneMappingExposure = 0.8;
    this.#renderer = renderer;
    this.#scene.background = new Color(BACKDROP);
    const room = new PMREMGenerator(renderer);
    // Its least size, 256 px a face, would keep a page without a graphics processor for four seconds.
    if (this.#isSlow) room._setSize = () => (room._cubeSize = 64);
    this.#scene.environment = room.fromScene(new RoomEnvironment(), 0.03).texture;
    this.#scene.environmentIntensity = BENCH_GLOSS;
    room.dispose();
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(1, 0.6, 1);
    this.#lamp.castShadow = true;
    this.#lamp.shadow.mapSize.setScalar(this.#isSlow ? 1024 : 2048);
    this.#lamp.shadow.normalBias = 0.002;
    this.#scene.add(this.#lamp, this.#lamp.target, this.#scopeLight, this.#scopeLight.target, this.#sky, this.#contacts.group);
    this.#controls = new OrbitControls(this.camera, canvas);
    this.#controls.enableDamping = true;
    this.#controls.dampingFactor = 0.12;
    this.#controls.minDistance = 0.02;
    this.#controls.maxDistance = 8;
    this.#controls.addEventListener("start", () => this.#free());
    canvas.addEventListener("dblclick", (event) => this.#lookThere(event));
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
  }

  addMesh({ number, positions, normals, triangles, colours }) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    geometry.setAttribute("normal", new BufferAttribute(normals, 3));
    if (colours) geometry.setAttribute("color", new BufferAttribute(colours, 3));
    geometry.setIndex(new BufferAttribute(triangles, 1));
    this.#geometries.get(number)?.dispose();
    this.#geometries.set(number, geometry);
  }

  /** Takes note of what frames of a scene are made of; it is put up with the first of them. While `place`, what
   * is watched where, is the same, the camera stays where it is. */
  addScene(card, place) {
    this.#cards.set(card.number, { ...card, place });
  }

  /** What frames with this number are made of, as the server said it. */
  sceneOf(number) {
    return this.#cards.get(number);
  }

  /** On another connection scenes are numbered anew. What is there stays until it shows something else. */
  forget() {
    this.#cards.clear();
    this.#card = null;
  }

  #putUp(card) {
    for (const number of this.#cards.keys()) if (number < card.number) this.#cards.delete(number);
    for (const part of this.#parts) this.#scene.remove(part);
    this.#card = card;
    this.#parts = card.parts.map((part) => {
      const isGoal = card.bodies[part.body - 1] === "goal";
      const geometry = this.#geometries.get(part.mesh);
      const mesh = new Mesh(geometry, this.#material(part, isGoal, geometry.hasAttribute("color")));
      mesh.castShadow = !isGoal;
      mesh.receiveShadow = !isGoal;
      mesh.scale.setScalar(part.size);
      mesh.name = card.bodies[part.body - 1];
      this.#scene.add(mesh);
      return mesh;
    });
    this.#light(card);
  }

  #material({ colour, metallic, roughness }, isGoal, isPainted) {
    const key = [...colour, metallic, roughness, isGoal, isPainted].join();
    if (!this.#materials.has(key)) {
      // Vertices that have colours have all of it.
      const color = isPainted ? new Color(0xffffff) : new Color().setRGB(...colour);
      const material = new MeshStandardMaterial({ color, metalness: metallic, roughness, vertexColors: isPainted });
      if (isGoal) {
        material.emissive = color;
        material.emissiveIntensity = 0.55;
        material.transparent = true;
        material.opacity = 0.85;
      }
      this.#materials.set(key, material);
    }
    return this.#materials.get(key);
  }

  #light({ light, stage }) {
    const [low, high] = stage.map((corner) => new Vector3(...corner));
    const middle = low.clone().add(high).multiplyScalar(0.5);
    const radius = low.distanceTo(high) * 0.6;
    this.#lamp.color.setRGB(...light.lamp);
    this.#lamp.intensity = 1.9;
    this.#lamp.target.position.copy(middle);
    const isFar = light.direction !== null;
    this.#lamp.visible = isFar;
    this.#lamp.position.copy(middle).addScaledVector(new Vector3(...(light.direction ?? [0, 0, 1])), 2 * radius + 0.5);
    this.#scopeLight.visible = !isFar;
    this.#scopeLight.color.setRGB(...light.lamp);
    this.#scene.environmentIntensity = isFar ? BENCH_GLOSS : CAVITY_GLOSS;
    this.#scene.background.set(isFar ? BACKDROP : CAVITY_BACKDROP);
    const shadow = this.#lamp.shadow.camera;
    Object.assign(shadow, { left: -radius, right: radius, top: radius, bottom: -radius, near: 0.05, far: 4 * radius + 1 });
    shadow.updateProjectionMatrix();
    this.#sky.color.setRGB(...light.sky);
    this.#sky.groundColor.setRGB(...light.ground);
    this.#sky.position.set(0, 0, 1);
    this.#sky.intensity = 0.75;
    this.#scene.fog = new Fog(this.#scene.background, 2.2 + radius, 5.5 + 2 * radius);
  }

  /** Shows a moment, `fraction` of the way from the frame before, where there is one. */
  show(frame, before = null, fraction = 1) {
    const card = this.#cards.get(frame.scene);
    if (!card) return;
    if (card !== this.#card) this.#putUp(card);
    if (before?.scene !== frame.scene) before = null;
    this.#parts.forEach((part, index) => place(part, frame.poses, 7 * index, before?.poses, fraction));
    this.#bend(card, frame.skins, before?.skins, fraction);
    this.#contacts.show(frame.contacts);
    this.#endoscope = frame.endoscope;
    if (frame.endoscope) this.#moveScopeLight(frame.endoscope);
    if (card.place !== this.#place) this.#open();
    else if (this.#view === "close") this.closeUp();
    this.#place = card.place;
    if (this.#view === "endoscope") this.#rideAlong();
    this.#dirty = true;
  }

  /** Puts the vertices of what deforms where they are, a fraction of the way from those before. */
  #bend(card, skins, before, fraction) {
    let at = 0;
    this.#parts.forEach((part, index) => {
      if (!card.parts[index].deforms) return;
      const { position } = part.geometry.attributes;
      const ends = before && fraction < 1 ? [[before, 1 - fraction], [skins, fraction]] : [[skins, 1]];
      position.array.fill(0);
      for (const [words, share] of ends) addSkin(position.array, words, at, share);
      at += 6 + Math.ceil(position.array.length / 2);
      position.needsUpdate = true;
      part.geometry.computeVertexNormals();
      part.geometry.computeBoundingSphere();
    });
  }

  #moveScopeLight(pose) {
    atEndoscope(this.#scopeLight, pose);
    this.#scopeLight.target.position.set(0, 0, -1).applyQuaternion(this.#scopeLight.quaternion).add(this.#scopeLight.position);
  }

  set showsContacts(shows) {
    this.#contacts.group.visible = shows;
    this.#dirty = true;
  }

  get showsContacts() {
    return this.#contacts.group.visible;
  }

  /** The direction in which the viewer looks, rad about the vertical from x towards y. */
  get heading() {
    const ahead = new Vector3(0, 0, -1).applyQuaternion(this.camera.quaternion);
    // Straight down, what is up in the picture is ahead.
    if (Math.hypot(ahead.x, ahead.y) < 0.1) ahead.set(0, 1, 0).applyQuaternion(this.camera.quaternion);
    return Math.atan2(ahead.y, ahead.x);
  }

  /** The first view: of the jaws at work, where there are any. */
  #open() {
    if (this.#jaws().length > 0) this.closeUp();
    else this.overview();
  }

  #jaws() {
    return this.#parts.filter((part) => /jaw_\d+_link$/.test(part.name));
  }

  /** Looks from where the task's overview is. */
  overview() {
    const { pose, view } = this.#card.overview;
    const turn = new Quaternion(...pose.slice(3)).multiply(FROM_OPENCV);
    const eye = new Vector3(...pose.slice(0, 3));
    const forward = new Vector3(0, 0, -1).applyQuaternion(turn);
    const [low, high] = this.#card.stage.map((corner) => new Vector3(...corner));
    const distance = low.add(high).multiplyScalar(0.5).sub(eye).dot(forward);
    this.#shift = [0, 0];
    this.#look("overview", eye, eye.clone().addScaledVector(forward, distance), view);
  }

  /** Jaws and objects, or the endoscope's tip: a sphere around them. */
  #seen() {
    const jaws = this.#jaws();
    const isObject = (part) => !/^(psm|ecm|other )/.test(part.name) && sphereOf(part).radius < LARGEST_OBJECT;
    const scope = this.#parts.filter((part) => part.name.startsWith("ecm")).slice(-1);
    const seen = jaws.length > 0 ? [...jaws, ...this.#parts.filter(isObject)] : scope;
    return seen.reduce((all, part) => all.union(sphereOf(part)), new Sphere().makeEmpty());
  }

  /** Lets the jaws, and what they are to work with, fill what no panel covers, and goes with them. */
  closeUp() {
    const { center, radius } = this.#seen();
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    const [left, top, right, bottom] = this.clearing();
    this.#shift = [(left + right) / 2 / width - 0.5, (top + bottom) / 2 / height - 0.5];
    // The sphere's outline touches the nearer edges of that part.
    const half = Math.min(right - left, bottom - top) / Math.min(width, height);
    const distance = radius * Math.hypot(1, 1 / (half * Math.tan(CLOSE_VIEW / 2)));
    const from = new Vector3(0.75, 0.5, 0.42).normalize();
    this.#look("close", center.clone().addScaledVector(from, distance), center, CLOSE_VIEW);
  }

  /** Looks through the endoscope, and goes with it. */
  rideEndoscope() {
    if (!this.#endoscope) return;
    this.#turnTo("endoscope");
    this.#controls.enabled = false;
    this.#shift = [0, 0];
    this.#rideAlong();
    this.#dirty = true;
  }

  #rideAlong() {
    if (!this.#endoscope) return;
    atEndoscope(this.camera, this.#endoscope);
    this.#setView(this.#endoscope[7]);
  }

  /** Takes the camera off the endoscope, a little further back along its axis. */
  #free() {
    if (this.#view === "endoscope") {
      const forward = new Vector3(0, 0, -1).applyQuaternion(this.camera.quaternion);
      this.#controls.target.copy(this.camera.position).addScaledVector(forward, 0.15);
    }
    this.#controls.enabled = true;
    this.#turnTo("");
  }

  #turnTo(view) {
    this.#view = view;
    this.onView(view);
  }

  /** The user touched the picture while it goes with the endoscope. */
  takeCamera() {
    if (this.#view === "endoscope") this.#free();
  }

  #look(name, eye, target, view) {
    this.#turnTo(name);
    this.#controls.enabled = true;
    this.camera.position.copy(eye);
    this.#controls.target.copy(target);
    this.#setView(view);
    this.#controls.update();
    this.#dirty = true;
  }

  #lookThere(event) {
    const box = this.#canvas.getBoundingClientRect();
    const at = new Vector2(((event.clientX - box.x) / box.width) * 2 - 1, 1 - ((event.clientY - box.y) / box.height) * 2);
    const ray = new Raycaster();
    ray.setFromCamera(at, this.camera);
    const [hit] = ray.intersectObjects(this.#parts, false);
    if (hit) {
      this.#controls.target.copy(hit.point);
      this.#dirty = true;
    }
  }

  /** `view`: the angle from the upper to the lower edge, rad; in a narrow window, from side to side. */
  #setView(view) {
    const narrow = Math.min(1, this.camera.aspect);
    this.camera.userData.view = view;
    this.camera.fov = (2 * Math.atan(Math.tan(view / 2) / narrow) * 180) / Math.PI;
    const [right, down] = this.#shift;
    this.camera.setViewOffset(1, 1, -right, -down, 1, 1);
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width === 0 || height === 0) return;
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * this.#fineness);
    this.#renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.#setView(this.camera.userData.view ?? 0.78);
    if (this.#view === "close") this.closeUp();
    this.#dirty = true;
  }

  /** Draws where something has moved; `now` in ms. */
  draw(now) {
    if (this.#view !== "endoscope" && this.#controls.update()) this.#dirty = true;
    if (!this.#dirty) return;
    this.#dirty = false;
    this.#keepUp(now);
    this.#drawEndoscope();
    this.#renderer.render(this.#scene, this.camera);
  }

  /** Draws what the endoscope sees onto a canvas of its own: first, onto a corner that the theatre covers. */
  #drawEndoscope() {
    if (!this.inset || !this.#endoscope) return;
    // As fine as the corner allows, which a slow machine makes coarse.
    const { width: wide, height: high } = this.inset;
    const scale = Math.min(1, this.#canvas.width / wide, this.#canvas.height / high);
    const width = Math.floor(wide * scale), height = Math.floor(high * scale);
    const ratio = this.#renderer.getPixelRatio();
    const showsContacts = this.showsContacts;
    this.#contacts.group.visible = false;
    atEndoscope(this.#lens, this.#endoscope);
    this.#lens.fov = (this.#endoscope[7] * 180) / Math.PI;
    this.#lens.updateProjectionMatrix();
    this.#renderer.setViewport(0, 0, width / ratio, height / ratio);
    this.#renderer.setScissor(0, 0, width / ratio, height / ratio);
    this.#renderer.setScissorTest(true);
    this.#renderer.render(this.#scene, this.#lens);
    this.inset.getContext("2d").drawImage(this.#canvas, 0, this.#canvas.height - height, width, height, 0, 0, wide, high);
    this.#renderer.setScissorTest(false);
    this.#renderer.setViewport(0, 0, this.#canvas.width / ratio, this.#canvas.height / ratio);
    this.#contacts.group.visible = showsContacts;
  }

  /** Makes do with fewer pixels where the machine cannot draw as many in time. */
  #keepUp(now) {
    const isLate = now - this.#drawn > LATE && now - this.#drawn < 100 * LATE;
    this.#drawn = now;
    this.#late = isLate ? this.#late + 1 : Math.max(0, this.#late - 2);
    if (this.#late < 8 || this.#fineness < 0.45) return;
    this.#late = 0;
    this.#fineness *= 0.75;
    this.#resize();
  }

  /** A picture of what is shown, as a PNG. */
  save(take) {
    this.#renderer.render(this.#scene, this.camera);
    this.#canvas.toBlob(take, "image/png");
  }
}

/** A sphere around a part. */
function sphereOf(part) {
  if (!part.geometry.boundingSphere) part.geometry.computeBoundingSphere();
  part.updateMatrixWorld();
  return part.geometry.boundingSphere.clone().applyMatrix4(part.matrixWorld);
}

/** Whether nothing but the processor draws here. Not all browsers that do so say that it is slow. */
function drawsInSoftware() {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2", { failIfMajorPerformanceCaveat: true });
  const names = context?.getExtension("WEBGL_debug_renderer_info");
  return !context || /swiftshader|llvmpipe|software/i.test(context.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
}

/** Adds a share of the places of a skin, which begins at a word: the box's corner, the edge of a step along each axis,
 * steps of 16 bits. */
function addSkin(positions, words, at, share) {
  const box = new Float32Array(words.buffer, words.byteOffset + 4 * at, 6);
  const steps = new Uint16Array(words.buffer, words.byteOffset + 4 * (at + 6), positions.length);
  for (let index = 0; index < positions.length; index++) {
    const axis = index % 3;
    positions[index] += share * (box[axis] + box[3 + axis] * steps[index]);
  }
}

/** Puts a camera, or what else looks along −z, where the endoscope is. */
function atEndoscope(camera, [x, y, z, qx, qy, qz, qw]) {
  camera.position.set(x, y, z);
  camera.quaternion.set(qx, qy, qz, qw).multiply(FROM_OPENCV);
}

const start = new Vector3(), startTurn = new Quaternion();

/** Puts a part at a pose, a fraction of the way from the one before. */
function place(part, poses, at, before, fraction) {
  part.position.fromArray(poses, at);
  part.quaternion.fromArray(poses, at + 3);
  if (before && fraction < 1) {
    start.fromArray(before, at);
    startTurn.fromArray(before, at + 3);
    part.position.lerpVectors(start, part.position.clone(), fraction);
    part.quaternion.copy(startTurn.slerp(part.quaternion, fraction));
  }
}

/** Contacts as points, and their forces as arrows that point where they push. */
class Contacts {
  group = new Group();
  #points;
  #shafts;
  #heads;

  constructor() {
    const look = (color) => new MeshBasicMaterial({ color, depthTest: false, transparent: true, opacity: 0.9, toneMapped: false });
    const many = (geometry, color) => {
      const mesh = new InstancedMesh(geometry, look(color), MOST_CONTACTS);
      mesh.frustumCulled = false;
      mesh.renderOrder = 10;
      mesh.count = 0;
      this.group.add(mesh);
      return mesh;
    };
    this.#shafts = many(new CylinderGeometry(1, 1, 1, 10).translate(0, 0.5, 0), 0xffb454);
    this.#heads = many(new ConeGeometry(1, 1, 14).translate(0, 0.5, 0), 0xffb454);
    this.#points = many(new SphereGeometry(1, 12, 8), 0xfff1d6);
  }

  show(contacts) {
    const matrix = new Matrix4(), point = new Vector3(), force = new Vector3(), size = new Vector3(), end = new Vector3();
    const turn = new Quaternion(), up = new Vector3(0, 1, 0);
    const count = contacts.length / 6;
    for (let index = 0; index < count; index++) {
      point.fromArray(contacts, 6 * index);
      force.fromArray(contacts, 6 * index + 3);
      const newtons = force.length();
      const length = Math.min(LONGEST, newtons * ARROW);
      turn.setFromUnitVectors(up, force.normalize());
      this.#points.setMatrixAt(index, matrix.compose(point, turn, size.setScalar(newtons > 0.01 ? 6e-4 : 3e-4)));
      this.#shafts.setMatrixAt(index, matrix.compose(point, turn, size.set(2.2e-4, length, 2.2e-4)));
      const head = Math.min(2.4e-3, 0.45 * length);
      end.copy(point).addScaledVector(force, length);
      this.#heads.setMatrixAt(index, matrix.compose(end, turn, size.set(0.36 * head, head, 0.36 * head)));
    }
    for (const mesh of [this.#points, this.#shafts, this.#heads]) {
      mesh.count = count;
      mesh.instanceMatrix.needsUpdate = true;
    }
  }
}
