"use strict";
// Shows what the server tells, and hands back what the person does: nothing is decided here.
const at = (id) => document.getElementById(id);
const SILENT_MS = 12000; // the server tells something every 4 s
const COLOURS = ["#ff5a5a", "#5fe07a", "#6aa5ff"];
const buttons = [...document.querySelectorAll("button[data-action]")];
const usual = new Map(buttons.map((button) => [button, button.textContent]));
let view = null, heard = performance.now();

history.replaceState(null, "", "/"); // the token is in a cookie now

function duration(seconds) {
  const minutes = Math.round(seconds / 60);
  if (minutes < 1) return "less than a minute left";
  return minutes < 100 ? `about ${minutes} min left` : `about ${Math.floor(minutes / 60)} h ${minutes % 60} min left`;
}

function drawHistogram(rows) {
  const canvas = at("histogram"), pen = canvas.getContext("2d");
  const most = Math.sqrt(Math.max(...rows.flat(), 1e-9)), step = canvas.width / rows[0].length;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.globalCompositeOperation = "lighter";
  rows.forEach((row, band) => {
    pen.fillStyle = COLOURS[band];
    pen.globalAlpha = 0.7;
    // Roots of shares: a few blown pixels are to be seen beside a large dark ground.
    row.forEach((share, bin) => {
      const high = Math.sqrt(share) / most * canvas.height;
      pen.fillRect(bin * step, canvas.height - high, step, high);
    });
  });
}

function drawPhotograph(shown) {
  at("photograph").hidden = !shown;
  if (!shown) return;
  at("file").textContent = shown.file || "Test exposure, not kept";
  at("finding").textContent = shown.finding;
  drawHistogram(shown.histogram);
  for (const [id, source] of [["picture", `/picture/${shown.number}`], ["overlay", `/overlay/${shown.number}`]])
    if (at(id).getAttribute("src") !== source) at(id).src = source;
  at("outlining").hidden = !shown.outline;
  showOutline();
  at("outline").setAttribute("viewBox", `0 0 ${shown.extent[0]} ${shown.extent[1]}`);
  at("outline").setAttribute("aria-label", shown.outlined || "");
  for (const path of at("outline").children) path.setAttribute("d", shown.outline || "");
}

function showOutline() { at("outline").toggleAttribute("hidden", at("outlining").hidden || !at("lines").checked); }

function draw() {
  document.title = `${view.done}/${view.total} ${view.name}`;
  at("name").textContent = view.name;
  at("progress").textContent = view.total ? `${view.done} of ${view.total}, ${view.done < view.total ? duration(view.left_s) : "none left"}` : "";
  at("bar").max = view.total || 1;
  at("bar").value = view.done;
  if (at("words").textContent !== view.words) at("words").textContent = view.words;
  at("note").textContent = view.wanted ? `As soon as this photograph is stored: ${view.wanted.replace("-", " ")}.` : view.note;
  for (const button of buttons) {
    button.disabled = !(button.dataset.action in view.offers);
    button.textContent = view.offers[button.dataset.action] || usual.get(button);
  }
  at("keeping").hidden = !("keep" in view.offers);
  document.body.dataset.state = view.state;
  drawPhotograph(view.shown);
}

async function act(action) {
  const seen = view.turn;
  for (const button of buttons) if (button.dataset.action !== "stop") button.disabled = true;
  try {
    const answer = await fetch("/act", {
      method: "POST",
      headers: {"Content-Type": "application/json"},
      body: JSON.stringify({action, turn: seen, reason: action === "keep" ? at("reason").value : ""}),
    });
    if (answer.ok && action === "keep") at("reason").value = "";
    if (!answer.ok) { draw(); at("note").textContent = await answer.text(); }
  } catch {
    draw();
    at("note").textContent = "The session was not reached: nothing was done.";
  }
}

const news = new EventSource("/news");
news.onmessage = (event) => {
  heard = performance.now();
  view = JSON.parse(event.data);
  at("lost").hidden = true;
  draw();
  if (view.state === "ended") news.close();
};
news.addEventListener("beat", () => { heard = performance.now(); at("lost").hidden = true; });
function lose() {
  if (view && view.state === "ended") return;
  at("lost").hidden = false;
  if (news.readyState === EventSource.CLOSED)
    at("lost").textContent = "The session was restarted: open the address that its terminal shows.";
}
news.onerror = lose;
setInterval(() => { if (performance.now() - heard > SILENT_MS) lose(); }, 1000);
for (const button of buttons) button.addEventListener("click", () => act(button.dataset.action));
at("marks").addEventListener("change", () => { at("overlay").hidden = !at("marks").checked; });
at("lines").addEventListener("change", showOutline);
