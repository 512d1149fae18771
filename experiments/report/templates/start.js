// Every part whose place and data the page has.

document.documentElement.classList.add("scripted");
const charts = [...document.querySelectorAll("[data-chart]")];
const groupNames = [...new Set(charts.flatMap((place) => readJson(place.dataset.chart).groups))];
const lookOf = (group) => groupNames.indexOf(group);
const viewerPlace = document.getElementById("viewer"), viewerJson = readJson("viewer-data");
const mainChart = charts.length ? readJson(charts[0].dataset.chart) : null;
if (viewerPlace && viewerJson) startViewer(viewerPlace, viewerJson, mainChart);
for (const place of charts) {
  const data = readJson(place.dataset.chart);
  if (data.points.length && data.x.length && data.y.length) makeScatter(place, data, lookOf);
  else place.replaceChildren(el("p", { class: "soft" }, "No reference frames, so no errors."));
}
const curvePlace = document.getElementById("curves"), curveJson = readJson("curve-data");
if (curvePlace && curveJson) startCurves(curvePlace, curveJson, mainChart, lookOf);
const stabilityTable = document.getElementById("stability-map");
if (stabilityTable) startStability(stabilityTable, readJson("stability-data"));
for (const table of document.querySelectorAll("table.sortable")) makeSortable(table);
startPictures(document.querySelectorAll(".pictures img, .views img"));
