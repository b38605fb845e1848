"use strict";
// On paper everything is open.
window.addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => { one.open = true; }));
// Sorting: a click on a head sorts by its column, numbers as numbers.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  table.querySelectorAll("th").forEach((head, column) => {
    head.tabIndex = 0;
    const sort = () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      table.querySelectorAll("th").forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const value = (row) => {
        const text = row.cells[column].textContent.trim();
        const number = parseFloat(text);
        return text !== "" && !Number.isNaN(number) ? number : text === "-" ? Infinity : text;
      };
      const rows = [...body.rows];
      rows.sort((a, b) => {
        const x = value(a), y = value(b);
        const order = typeof x === "number" && typeof y === "number" ? (x === y ? 0 : x < y ? -1 : 1)
          : String(x).localeCompare(String(y));
        return up ? order : -order;
      });
      rows.forEach((row) => body.appendChild(row));
    };
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); sort(); } });
  });
}
// Meshes: nodes between their initial and final positions, coloured by a field.
const viewer = document.getElementById("viewer");
if (viewer) {
  const solves = JSON.parse(document.getElementById("meshes-json").textContent);
  const canvas = viewer.querySelector("canvas"), pen = canvas.getContext("2d");
  const chosen = viewer.querySelector("#solve"), slider = viewer.querySelector("#slider");
  const field = viewer.querySelector("#field"), shown = viewer.querySelector("#shown"), hover = viewer.querySelector(".hover");
  const MAP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // viridis
  const colour = (part) => {
    const at = Math.min(Math.max(part, 0), 1) * 4, i = Math.min(Math.floor(at), 3), w = at - i;
    return "rgb(" + MAP[i].map((c, k) => Math.round(c + w * (MAP[i + 1][k] - c))).join(",") + ")";
  };
  solves.forEach((solve, i) => chosen.add(new Option(solve.name, i)));
  const low = viewer.querySelector("#low"), high = viewer.querySelector("#high");
  let place = [], printed = false;
  // In print the given and the relocated mesh stand side by side; on the screen there is one, where the slider is.
  const draw = () => {
    const solve = solves[chosen.value], t = Number(slider.value), steps = printed ? [0, 1] : [t];
    const width = Math.max(canvas.clientWidth, 200), ratio = printed ? 3 : window.devicePixelRatio || 1;
    const all = { x: solve.x.concat(solve.x0), y: solve.y.concat(solve.y0) };
    const lo = [Math.min(...all.x), Math.min(...all.y)], hi = [Math.max(...all.x), Math.max(...all.y)];
    const pad = 12, head = printed ? 16 : 0, each = width / steps.length;
    const scale = Math.min((each - 2 * pad) / (hi[0] - lo[0] || 1), 560 / (hi[1] - lo[1] || 1));
    const height = (hi[1] - lo[1]) * scale + 2 * pad + head;
    canvas.width = width * ratio; canvas.height = height * ratio; canvas.style.height = height + "px";
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const values = solve.fields[field.value], least = Math.min(...values), most = Math.max(...values);
    steps.forEach((step, panel) => {
      const left = panel * each + (each - (hi[0] - lo[0]) * scale) / 2;
      place = solve.x0.map((_, i) => {
        const x = solve.x0[i] + step * (solve.x[i] - solve.x0[i]), y = solve.y0[i] + step * (solve.y[i] - solve.y0[i]);
        return [left + (x - lo[0]) * scale, height - pad - (y - lo[1]) * scale, x, y];
      });
      pen.lineWidth = 0.6; pen.strokeStyle = "#fff";
      const trace = (cell) => {
        pen.beginPath(); pen.moveTo(place[cell[0]][0], place[cell[0]][1]);
        [0, 1, 2].forEach((k) => {
          const a = place[cell[k]], b = place[cell[(k + 1) % 3]], m = place[cell[3 + k]];
          if (m) pen.quadraticCurveTo(2 * m[0] - (a[0] + b[0]) / 2, 2 * m[1] - (a[1] + b[1]) / 2, b[0], b[1]);
          else pen.lineTo(b[0], b[1]);
        });
        pen.closePath();
      };
      const paint = (cell) => {
        const [a, b, c] = cell;
        pen.fillStyle = colour(((values[a] + values[b] + values[c]) / 3 - least) / (most - least || 1));
        trace(cell); pen.fill();
      };
      for (const cell of solve.t) {
        paint(cell);
        if (cell.length === 6) [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]].forEach((one) => paint(one.map((k) => cell[k])));
        trace(cell); pen.stroke();
      }
      if (printed) {
        pen.fillStyle = "#1a1a1a"; pen.font = "12px sans-serif";
        pen.fillText((step === 0 ? "given" : "relocated") + ": " + solve.name, left, 12);
      }
    });
    low.textContent = field.value + " " + least.toPrecision(4); high.textContent = most.toPrecision(4);
    shown.textContent = Math.round(100 * t) + " %";
    viewer.dataset.drawn = chosen.value + " " + steps + " " + field.value;
  };
  window.addEventListener("beforeprint", () => { printed = true; draw(); });
  window.addEventListener("afterprint", () => { printed = false; draw(); });
  const choose = () => {
    const solve = solves[chosen.value], before = field.value;
    field.replaceChildren(...Object.keys(solve.fields).map((name) => new Option(name, name)));
    if (before in solve.fields) field.value = before;
    draw();
  };
  canvas.addEventListener("pointermove", (event) => {
    const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    let best = -1, least = 400;
    place.forEach((p, i) => { const d = (p[0] - x) ** 2 + (p[1] - y) ** 2; if (d < least) { least = d; best = i; } });
    const solve = solves[chosen.value];
    hover.textContent = best < 0 ? "Point at a node to read its values." : "node " + best + " at (" + place[best][2].toPrecision(4) + ", "
      + place[best][3].toPrecision(4) + "): " + Object.entries(solve.fields).map(([name, v]) => name + " " + v[best].toPrecision(4)).join(", ");
  });
  chosen.addEventListener("change", choose); slider.addEventListener("input", draw); field.addEventListener("change", draw);
  window.addEventListener("resize", draw);
  choose();
}
