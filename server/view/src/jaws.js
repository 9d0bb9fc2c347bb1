// The state of jaws: how far they are open, and what presses on them.

import { short } from "./chart.js";

/** Force that fills a bar, N. */
const FULL = 2;

/** `arms`: their names; `jaws`: opening, asked (rad) and two pressures (N) of each. */
export function showJaws(place, arms, jaws) {
  while (place.children.length > arms.length) place.lastChild.remove();
  arms.forEach((arm, index) => {
    const [opening, asked, one, other] = jaws.subarray(4 * index, 4 * index + 4);
    const gauge = place.children[index] ?? place.appendChild(newGauge());
    const put = (query, text) => (gauge.querySelector(query).textContent = text);
    put("b", arm.toUpperCase());
    put(".angle", `${((opening * 180) / Math.PI).toFixed(1)}°`);
    gauge.querySelector(".fingers").setAttribute("d", fingers(opening, 32));
    gauge.querySelector(".asked").setAttribute("d", fingers(Math.max(asked, 0), 36));
    const bars = gauge.querySelectorAll(".squeeze i b");
    [one, other].forEach((newtons, side) => (bars[side].style.width = `${Math.min(100, (100 * newtons) / FULL)}%`));
    put(".force", `${short(Math.max(one, other))} N`);
  });
}

function newGauge() {
  const gauge = document.createElement("div");
  gauge.className = "jaw";
  gauge.innerHTML = `<svg viewBox="0 0 46 34"><path class="asked"/><path class="fingers"/></svg>
    <span class="row"><b></b><span class="angle"></span></span>
    <span class="squeeze"><i><b></b></i><i><b></b></i><span class="force"></span></span>`;
  return gauge;
}

/** Two lines of a length from the hinge, an angle (rad) apart. */
function fingers(angle, length) {
  const [x, y] = [length * Math.cos(angle / 2), length * Math.sin(angle / 2)];
  const offset = 2;
  return `M4 ${17 - offset}L${4 + x} ${17 - offset - y}M4 ${17 + offset}L${4 + x} ${17 + offset + y}`;
}
