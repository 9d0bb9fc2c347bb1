// The list of sessions.

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

/**
 * Shows a card for each session, or each recording (`isTape`), the one that is watched marked; `choose(id)` is
 * called for a click.
 */
export function sessionCards(list, sessions, { watched, server, isTape }, choose) {
  const cards = new Map([...list.querySelectorAll(".session")].map((card) => [Number(card.dataset.id), card]));
  const shown = sessions.map((session) => {
    const card = cards.get(session.id) ?? newCard(session.id, choose);
    (isTape ? fillTape : fill)(card, session);
    card.setAttribute("aria-current", session.id === watched);
    return card;
  });
  if (shown.length === 0) shown.push(nobody(server));
  // What is there already stays, with its focus.
  if (shown.length !== list.children.length || shown.some((card, index) => card !== list.children[index])) {
    list.replaceChildren(...shown);
  }
}

function newCard(id, choose) {
  const card = document.createElement("button");
  card.className = "session";
  card.dataset.id = id;
  card.innerHTML = `<span class="row"><b></b><span class="rate"></span></span>
    <span class="row facts"><span class="envs"></span><span class="speed"></span></span>
    <span class="row facts"><span class="who"></span><span class="latency"></span></span>
    <span class="meter"><i></i></span>`;
  card.querySelector(".meter").style.display = "block";
  card.onclick = () => choose(id);
  return card;
}

function fill(card, session) {
  const put = (place, text) => (card.querySelector(place).textContent = text);
  const rate = session.success_rate;
  put("b", session.task.replace(/-v\d+$/, ""));
  put(".rate", rate === null ? "" : `${Math.round(100 * rate)} %`);
  put(".envs", session.envs === 1 ? "1 env" : `${whole.format(session.envs)} envs`);
  put(".speed", `${whole.format(session.steps_per_second)} steps/s`);
  put(".who", `${session.language} ${session.pid}`);
  put(".latency", `p50 ${micros(session.p50_us)} · p99 ${micros(session.p99_us)}`);
  card.querySelector(".meter").style.visibility = rate === null ? "hidden" : "visible";
  card.querySelector(".meter i").style.width = `${100 * (rate ?? 0)}%`;
  card.title = `session ${session.id} of ${session.language} ${session.pid}: ${session.task}, ${whole.format(session.episodes)} episodes; success of the latest 100`;
}

function fillTape(card, { language, task, envs }) {
  const put = (place, text) => (card.querySelector(place).textContent = text);
  put("b", language);
  put(".envs", task);
  put(".speed", envs === 1 ? "1 episode" : `${whole.format(envs)} episodes`);
  card.querySelector(".meter").style.visibility = "hidden";
}

function micros(time) {
  return time < 1000 ? `${Math.round(time)} µs` : `${(time / 1000).toFixed(time < 1e4 ? 1 : 0)} ms`;
}

function nobody(server) {
  const text = document.createElement("div");
  text.className = "none";
  text.textContent = "No sessions yet.";
  const code = document.createElement("code");
  code.textContent = `gym.make_vec(\n  "trocar/NeedlePick-v0",\n  num_envs=16,\n  server="${server ?? "lab"}",\n)`;
  text.append(code);
  return text;
}
