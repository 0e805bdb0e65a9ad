// The rig, its targets and the inliers as a 3-D view to rotate. Without WebGL the still picture stays.
(() => {
  const view = document.getElementById("scene-view");
  const choice = document.querySelector("#scene .choice");
  if (!document.createElement("canvas").getContext("webgl")) return;
  const scene = JSON.parse(document.getElementById("scene-data").textContent);
  const themeColor = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const xyz = ([x, y, z]) => ({ x, y, z });
  let by = "result";

  const line = (columns, name, width, color) => ({
    type: "scatter3d", mode: "lines", name, ...xyz(columns), connectgaps: false,
    line: { width, color }, hoverinfo: "name",
  });
  const cloud = (sensor, pose, hasScale) => ({
    type: "scatter3d", mode: "markers", name: sensor.name, ...xyz(pose.points),
    customdata: sensor.standardized_residuals,
    hovertemplate: "%{customdata:.1f} σ<br>x %{x:.3f} y %{y:.3f} z %{z:.3f} m",
    marker: {
      size: 2, color: sensor.standardized_residuals, cmin: -3, cmax: 3, showscale: hasScale,
      colorscale: [[0, "#3f83e8"], [0.5, "#8a93a0"], [1, "#d9483b"]],
      colorbar: { title: { text: "residual, σ" }, thickness: 10, len: 0.6 },
    },
  });
  const makeTraces = () => {
    const traces = [line(scene.targets, "targets", 1.5, themeColor("--muted"))];
    const visible = scene.sensors.filter((sensor) => sensor[by]);
    visible.forEach((sensor, i) => traces.push(cloud(sensor, sensor[by], i === 0)));
    for (const sensor of visible) {
      traces.push({ ...line(sensor[by].lines, sensor.name, 4, themeColor("--ink")), showlegend: false });
    }
    const [x, y, z] = [0, 1, 2].map((axis) => visible.map((sensor) => sensor[by].origin[axis]));
    traces.push({
      type: "scatter3d", mode: "text", x, y, z, text: visible.map((sensor) => sensor.name),
      textfont: { color: themeColor("--ink"), size: 11 }, hoverinfo: "skip", showlegend: false,
    });
    return traces;
  };
  const axis = (title) => ({
    title: { text: title }, gridcolor: themeColor("--grid"), zerolinecolor: themeColor("--line"),
    showbackground: false, color: themeColor("--muted"),
  });
  const layout = () => ({
    uirevision: "kept", margin: { l: 0, r: 0, t: 0, b: 0 },
    paper_bgcolor: "rgba(0,0,0,0)", font: { color: themeColor("--ink") },
    legend: { x: 0, y: 1, bgcolor: "rgba(0,0,0,0)" },
    scene: {
      aspectmode: "data", xaxis: axis("x, m"), yaxis: axis("y, m"), zaxis: axis("z, m"),
      camera: { eye: { x: 0.9, y: -1.5, z: 0.9 } }, uirevision: "kept",
    },
  });
  const options = { displayModeBar: false, responsive: true };
  const draw = () => Plotly.react(view, makeTraces(), layout(), options);

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
