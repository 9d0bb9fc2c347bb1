// The page: which session and environment is watched, and all that is shown of it beside the theatre.

import { Chart, short } from "./chart.js";
import { Drive } from "./drive.js";
import { Link } from "./link.js";
import { Player } from "./player.js";
import { sessionCards } from "./sessions.js";
import { showJaws } from "./jaws.js";
import { Tape } from "./tape.js";
import { Theatre } from "./theatre.js";

const STAGES = ["reach", "approach", "pick", "lift", "carry", "hand over", "place"];
const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
/** From so many times the speed of life on, episodes are shown and not the present. */
const FAST = 1.5;

const element = (id) => document.getElementById(id);
const theatre = new Theatre(element("theatre"));
const chart = new Chart(element("curve").querySelector("canvas"));
const picture = element("endoscope").querySelector("canvas");

let sessions = [];
/** No list has come yet. */
let isFirst = true;
let server = null;
let serverPid = null;
/** What is watched: {session, env}. */
let watched = null;
/** Whether anything was shown of it, or of what was watched before. */
let hasScene = false;
let wantsEndoscope = true;
/** Whether there is anything on the endoscope's canvas. */
let hasPicture = false;
let frames = 0;

const show = (frame, before, fraction) => theatre.show(frame, before, fraction);
const arrived = (frame) => {
  frame.marks.forEach((mark) => chart.add(mark));
  readOut(frame);
};
const live = new Player({ show, arrived, more: () => link.send("more") });
const tape = new Tape({
  show,
  arrived,
  rewound(frames) {
    chart.clear();
    frames.forEach(({ marks }) => marks.forEach((mark) => chart.add(mark)));
    readOut(frames.at(-1));
  },
  moved(at, last) {
    element("slider").max = last;
    element("slider").value = at;
    showPause();
  },
});
/** What plays: the tape where recordings are shown. */
let player = live;

const link = new Link({
  hello({ name, pid, version, recording }) {
    document.body.dataset.link = "open";
    player = recording ? tape : live;
    for (const id of ["slider", "rewind"]) element(id).hidden = !recording;
    element("pace").hidden = recording;
    element("what").textContent = recording ? "episode" : "env";
    theatre.forget();
    if (pid !== serverPid) watched = null;
    [server, serverPid] = [name, pid];
    element("server").textContent = name;
    element("server").title = `trocar ${version}, process ${pid}`;
    document.title = `${name} – Trocar`;
    notify();
    if (watched) watch(watched.session, watched.env);
  },
  sessions({ list }) {
    sessions = list;
    const wanted = isFirst ? fromAddress() : null;
    if (!watched && list.some(({ id }) => id === wanted?.session)) watch(wanted.session, wanted.env);
    else if (!watched && (list.length === 1 || (isFirst && player === tape && list.length))) watch(list[0].id, 0);
    isFirst = false;
    showSessions();
  },
  mesh: (mesh) => theatre.addMesh(mesh),
  scene: (card) => theatre.addScene(card, `${serverPid} ${card.session}`),
  frame(frame) {
    // What was watched before may still be on its way.
    const card = theatre.sceneOf(frame.scene);
    if (card && card.session === watched?.session && card.env === watched.env) player.push(frame);
  },
  async picture(png) {
    // The server draws the present; what is played is drawn here.
    if (player.pace !== "live") return;
    const bitmap = await createImageBitmap(png);
    picture.getContext("2d").drawImage(bitmap, 0, 0, picture.width, picture.height);
    bitmap.close();
    hasPicture = true;
    showEndoscope();
  },
  gone({ session }) {
    if (session !== watched?.session) return;
    drive.stop();
    watched = null;
    notify("mild", "The session has ended", "");
    showSessions();
  },
  error({ message }) {
    drive.stop();
    notify("mild", message, "");
  },
  bye() {},
  closed(ended) {
    document.body.dataset.link = ended ? "ended" : "lost";
    const name = server ? `“${server}” ` : "";
    if (ended) notify("", `The server ${name}has ended`, "What you see is its last moment. This page goes on by itself when a server is there again.");
    else notify("", server ? `The connection to the server ${name}is lost` : "No server answers", "It may have been killed, or the tunnel to it is down. Trying again…");
    element("server").textContent = ended ? "ended" : "not connected";
  },
});

const drive = new Drive((command) => link.send(command), () => theatre.heading);
drive.onChange = () => showSessions();

function watch(session, env) {
  if (session !== watched?.session) drive.stop();
  const card = sessions.find(({ id }) => id === session);
  const isOther = session !== watched?.session;
  if (isOther || env !== watched.env) {
    frames = 0;
    document.body.dataset.frames = frames;
    chart.clear();
  }
  watched = { session, env };
  if (card) {
    player.stepSeconds = card.seconds_per_step || 0.2;
    // Steps of one environment per second, over those of life.
    const haste = (card.steps_per_second / card.envs) * player.stepSeconds;
    // A live world has one episode, which does not end.
    if (isOther && player === live) player.pace = haste > FAST && !card.arms.length ? "episodes" : "live";
  }
  player.clear();
  hasPicture = false;
  showEndoscope();
  link.send({ watch: { session, env, pace: player.pace } });
  const token = drive.token ? `token=${drive.token}&` : "";
  history.replaceState(null, "", `#${token}session=${session}&env=${env}`);
  notify();
  showSessions();
}

function showEndoscope() {
  element("endoscope").hidden = !wantsEndoscope || !watched || !hasPicture;
  theatre.inset = player.pace === "episodes" && !element("endoscope").hidden ? picture : null;
}

function fromAddress() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  const [session, env] = [wanted.get("session"), wanted.get("env")].map(Number);
  return Number.isInteger(session) && session > 0 ? { session, env: Number.isInteger(env) ? env : 0 } : null;
}

function showSessions() {
  const isTape = player === tape;
  sessionCards(element("sessions"), sessions, { watched: watched?.session, server, isTape }, (id) => watch(id, 0));
  const card = sessions.find(({ id }) => id === watched?.session);
  const isEmpty = !watched && !hasScene;
  element("empty").hidden = !isEmpty;
  if (isEmpty) {
    element("empty").innerHTML = sessions.length
      ? "<h2>Choose a session</h2><p>and watch any of its environments</p>"
      : "<h2>Nobody trains here yet</h2><p>Sessions appear in the list as soon as they are opened.</p>";
  }
  for (const id of ["bar", "readout", "curve"]) element(id).hidden = isEmpty;
  if (!card) return;
  element("task").textContent = card.task;
  if (document.activeElement !== element("env")) element("env").value = watched.env;
  element("envs").textContent = `of ${card.envs}`;
  for (const id of ["previous", "next", "env"]) element(id).disabled = card.envs === 1;
  element("drive").hidden = !drive.offers(card);
  element("drive").setAttribute("aria-pressed", drive.isOn);
  element("drive").textContent = drive.isOn ? `Driving ${drive.arm}` : "Drive";
  document.body.dataset.drives = drive.isOn ? drive.arm : "";
  press("pace", "pace", player.pace);
  element("speed").hidden = player.pace === "live";
  element("speed").textContent = `${player.speed}×`.replace("0.25", "¼").replace("0.5", "½");
  showPause();
}

function showPause() {
  element("pause").textContent = player.isOver ? "Again" : player.paused ? "Go on" : "Pause";
  element("pause").setAttribute("aria-pressed", player.paused);
}

function press(group, key, value) {
  for (const button of element(group).querySelectorAll("button")) {
    button.setAttribute("aria-pressed", button.dataset[key] === value);
  }
}

/** The numbers of a frame that is shown. */
function readOut(frame) {
  frames += 1;
  hasScene = true;
  document.body.dataset.frames = frames;
  const card = sessions.find(({ id }) => id === watched?.session);
  element("step").textContent = `${frame.steps}${card?.max_steps ? ` / ${card.max_steps}` : ""}`;
  element("seed").textContent = frame.episode > 0n ? `${frame.seed}, episode ${frame.episode}` : `${frame.seed}`;
  element("stage").textContent = STAGES[frame.stage] ?? "–";
  const last = frame.marks.findLast((mark) => mark.isStep);
  if (last) {
    element("reward").textContent = short(last.reward);
    element("return").textContent = short(chart.total);
    const outcome = element("outcome");
    outcome.textContent = last.success ? "at the goal" : last.ended ? "not at the goal" : "";
    outcome.className = last.success ? "good" : "bad";
    if (card?.success_rate === null && !last.success) outcome.textContent = "";
  }
  if (player.pace === "episodes" && frame.endoscope && !hasPicture) {
    hasPicture = true;
    showEndoscope();
  }
  showJaws(element("jaws"), theatre.sceneOf(frame.scene)?.jaws ?? [], frame.jaws);
  const forces = Array.from({ length: frame.contacts.length / 6 }, (_, index) =>
    Math.hypot(...frame.contacts.subarray(6 * index + 3, 6 * index + 6)));
  element("contacts").textContent = forces.length ? `${forces.length}, up to ${short(Math.max(...forces))} N` : "none";
}

function notify(kind = null, title = "", text = "") {
  const notice = element("notice");
  notice.hidden = kind === null;
  notice.className = kind ?? "";
  const heading = document.createElement(kind === "mild" ? "span" : "h2");
  heading.textContent = title;
  const more = document.createElement("p");
  more.textContent = text;
  notice.replaceChildren(heading, ...(text ? [more] : []));
}

// ---- What the user does ----

const actions = {
  pause() {
    if (player.isOver) {
      player.paused = false;
      player.seek(0);
      return;
    }
    player.paused = !player.paused;
    link.send({ pause: player.paused });
    showSessions();
  },
  env(step) {
    const card = sessions.find(({ id }) => id === watched?.session);
    if (card) watch(card.id, (watched.env + step + card.envs) % card.envs);
  },
  session(step) {
    const at = sessions.findIndex(({ id }) => id === watched?.session);
    const next = sessions[(at + step + sessions.length) % sessions.length];
    if (next) watch(next.id, 0);
  },
  pace(pace) {
    player.pace = pace ?? (player.pace === "live" ? "episodes" : "live");
    if (watched) watch(watched.session, watched.env);
  },
  speed(step) {
    const at = SPEEDS.indexOf(player.speed) + step;
    player.speed = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, at))];
    showSessions();
  },
  move(frames) {
    if (player !== tape) return;
    player.paused = true;
    player.move(frames);
    showPause();
  },
  camera(name) {
    if (!hasScene) return;
    ({ overview: () => theatre.overview(), close: () => theatre.closeUp(), endoscope: () => theatre.rideEndoscope() })[name]();
  },
  contacts() {
    theatre.showsContacts = !theatre.showsContacts;
  },
  endoscope() {
    wantsEndoscope = !wantsEndoscope;
    showEndoscope();
  },
  save() {
    theatre.save((png) => {
      const anchor = document.createElement("a");
      anchor.href = URL.createObjectURL(png);
      anchor.download = `trocar-${element("task").textContent}-${element("step").textContent.split(" ")[0]}.png`;
      anchor.click();
      URL.revokeObjectURL(anchor.href);
    });
  },
  drive() {
    const card = sessions.find(({ id }) => id === watched?.session);
    if (drive.isOn) drive.stop();
    else if (drive.offers(card)) {
      notify();
      drive.start(card);
    }
  },
  help() {
    element("help").showModal();
  },
};

const KEYS = {
  " ": actions.pause,
  ArrowLeft: () => actions.env(-1),
  ArrowRight: () => actions.env(1),
  ArrowUp: () => actions.session(-1),
  ArrowDown: () => actions.session(1),
  1: () => actions.camera("overview"),
  2: () => actions.camera("close"),
  3: () => actions.camera("endoscope"),
  l: () => player === live && actions.pace(),
  ",": () => actions.move(-1),
  ".": () => actions.move(1),
  "-": () => actions.speed(-1),
  "+": () => actions.speed(1),
  "=": () => actions.speed(1),
  c: actions.contacts,
  e: actions.endoscope,
  s: actions.save,
  g: actions.drive,
  "?": actions.help,
};

addEventListener("keydown", (event) => {
  const isTyping = event.target instanceof HTMLInputElement && event.target.type !== "range";
  if (isTyping || event.ctrlKey || event.metaKey || event.altKey || element("help").open) return;
  if (drive.isOn && drive.key(event, true)) {
    event.preventDefault();
    return;
  }
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!act) return;
  event.preventDefault();
  act();
});

addEventListener("keyup", (event) => drive.isOn && drive.key(event, false));
addEventListener("blur", () => drive.release());

element("drive").onclick = ({ target }) => {
  actions.drive();
  target.blur();
};
element("pause").onclick = actions.pause;
element("rewind").onclick = () => player.seek(0);
element("slider").oninput = ({ target }) => {
  player.paused = true;
  player.seek(Number(target.value));
};
element("previous").onclick = () => actions.env(-1);
element("next").onclick = () => actions.env(1);
element("speed").onclick = () => actions.speed(player.speed === SPEEDS.at(-1) ? -SPEEDS.length : 1);
element("pace").onclick = ({ target }) => target.dataset.pace && actions.pace(target.dataset.pace);
element("cameras").onclick = ({ target }) => target.dataset.camera && actions.camera(target.dataset.camera);
element("env").onchange = ({ target }) => {
  const card = sessions.find(({ id }) => id === watched?.session);
  const env = Number.parseInt(target.value, 10);
  if (card && env >= 0 && env < card.envs) watch(card.id, env);
  target.blur();
  showSessions();
};
element("theatre").addEventListener("pointerdown", () => {
  theatre.takeCamera();
});
theatre.onView = (name) => press("cameras", "camera", name);
theatre.clearing = () => {
  const [whole, bar, readout, curve] = ["theatre", "bar", "readout", "curve"].map((id) => element(id).getBoundingClientRect());
  // In a narrow window the numbers are below, too.
  const isBelow = readout.left - whole.left < whole.width / 2;
  const right = isBelow ? whole.right : readout.left;
  const bottom = isBelow ? readout.top : curve.top;
  return [0, bar.bottom - whole.top, right - whole.left, bottom - whole.top];
};
showSessions();

function tick(now) {
  player.tick(now);
  theatre.draw(now);
  const card = sessions.find(({ id }) => id === watched?.session);
  chart.draw(2 * (card?.max_steps || 50));
  requestAnimationFrame(tick);
}
requestAnimationFrame(tick);
