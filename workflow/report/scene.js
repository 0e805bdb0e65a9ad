// The rig, its targets and what was measured of them, to be turned; a still picture without WebGL.
(() => {
  const view = document.getElementById("scene-view");
  const choice = document.querySelector("#scene .choice");
  if (!document.createElement("canvas").getContext("webgl")) return;
  const scene = JSON.parse(document.getElementById("scene-data").textContent);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const xyz = ([x, y, z]) => ({ x, y, z });
  let by = "result";

  const line = (columns, name, width, ink) => ({
    type: "scatter3d", mode: "lines", name, ...xyz(columns), connectgaps: false,
    line: { width, color: ink }, hoverinfo: "name",
  });
  const cloud = (sensor, pose, first) => ({
    type: "scatter3d", mode: "markers", name: sensor.name, ...xyz(pose.points),
    customdata: sensor.sigma,
    hovertemplate: "%{customdata:.1f} σ<br>x %{x:.3f} y %{y:.3f} z %{z:.3f} m",
    marker: {
      size: 2, color: sensor.sigma, cmin: -3, cmax: 3, showscale: first,
      colorscale: [[0, "#3f83e8"], [0.5, "#8a93a0"], [1, "#d9483b"]],
      colorbar: { title: { text: "residual, σ" }, thickness: 10, len: 0.6 },
    },
  });
  const shown = () => {
    const traces = [line(scene.targets, "targets", 1.5, colour("--muted"))];
    const posed = scene.sensors.filter((sensor) => sensor[by]);
    posed.forEach((sensor, i) => traces.push(cloud(sensor, sensor[by], i === 0)));
    for (const sensor of posed) {
      traces.push({ ...line(sensor[by].lines, sensor.name, 4, colour("--ink")), showlegend: false });
    }
    const [x, y, z] = [0, 1, 2].map((axis) => posed.map((sensor) => sensor[by].origin[axis]));
    traces.push({
      type: "scatter3d", mode: "text", x, y, z, text: posed.map((sensor) => sensor.name),
      textfont: { color: colour("--ink"), size: 11 }, hoverinfo: "skip", showlegend: false,
    });
    return traces;
  };
  const axis = (title) => ({
    title: { text: title }, gridcolor: colour("--grid"), zerolinecolor: colour("--line"),
    showbackground: false, color: colour("--muted"),
  });
  const layout = () => ({
    uirevision: "kept", margin: { l: 0, r: 0, t: 0, b: 0 },
    paper_bgcolor: "rgba(0,0,0,0)", font: { color: colour("--ink") },
    legend: { x: 0, y: 1, bgcolor: "rgba(0,0,0,0)" },
    scene: {
      aspectmode: "data", xaxis: axis("x, m"), yaxis: axis("y, m"), zaxis: axis("z, m"),
      camera: { eye: { x: 0.9, y: -1.5, z: 0.9 } }, uirevision: "kept",
    },
  });
  const plain = { displayModeBar: false, responsive: true };
  const draw = () => Plotly.react(view, shown(), layout(), plain);

  view.hidden = choice.hidden = false;
  draw().then(() => {
    document.getElementById("scene-still").hidden = true;
    view.dataset.drawn = "yes";
  });
  for (const button of choice.children) {
    button.addEventListener("click", () => {
      by = button.dataset.by;
      for (const other of choice.children) other.setAttribute("aria-pressed", other === button);
      draw();
    });
  }
  document.addEventListener("theme", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
})();
