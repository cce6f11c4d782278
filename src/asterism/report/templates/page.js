(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const config = { displaylogo: false, displayModeBar: false };

  function draw(box, traces, layout, more) {
    Plotly.newPlot(box, traces, layout, { ...config, ...more }).then(() => {
      new ResizeObserver(() => Plotly.Plots.resize(box)).observe(box);
    });
  }

  for (const [id, figure] of Object.entries(data.figures)) draw(document.getElementById(id), figure.data, figure.layout);

  function startScene(box, scene) {
    const view = box.querySelector(".view"), slider = box.querySelector("input[type=range]"), position = box.querySelector("output");
    const play = box.querySelector(".play"), names = box.querySelector(".names");
    const groups = ["left", "right", "middle", "wrong", "rest"];
    let timer = null;

    function column(points, axis) { return points.map(p => p === null ? null : p[axis] / 1000); }

    function traces(f) {
      const points = scene.points[f], wrong = new Set(scene.wrong[f]);
      const ends = [];
      for (const [a, b] of scene.bones) {
        if (points[a] && points[b]) ends.push(points[a], points[b], null);
      }
      const out = [{ points: ends, text: [] }];
      for (const group of groups) {
        if (group === "rest") { out.push({ points: scene.rest[f], text: scene.rest[f].map(() => "") }); continue; }
        const own = points.map((_, m) => m).filter(m => points[m] && (wrong.has(m) ? "wrong" : scene.side[m]) === group);
        out.push({ points: own.map(m => points[m]), text: own.map(m => scene.names[m]) });
      }
      return out;
    }

    const look = {
      left: ["#2563c9", "left", 5], right: ["#d1495b", "right", 5], middle: ["#23304d", "middle", 5],
      wrong: ["#ff2d1a", "wrong label", 8], rest: ["#9aa4b5", "no label", 4]
    };
    const first = traces(0);
    const drawn = first.map((trace, i) => {
      const xyz = { x: column(trace.points, 0), y: column(trace.points, 1), z: column(trace.points, 2) };
      if (i === 0) {
        return { type: "scatter3d", mode: "lines", line: { color: "#b9c4d4", width: 5 }, hoverinfo: "skip", showlegend: false, ...xyz };
      }
      const [color, name, size] = look[groups[i - 1]];
      return {
        type: "scatter3d", mode: i === 5 || !scene.named ? "markers" : "markers+text", name, text: trace.text, textposition: "top center",
        textfont: { size: 11, color: "#33415c" }, marker: { size, color, symbol: i === 4 ? "diamond" : "circle", line: { width: 0 } },
        hovertemplate: "%{text}<br>%{x:.3f}, %{y:.3f}, %{z:.3f} m<extra></extra>", showlegend: scene.shown.includes(groups[i - 1]), ...xyz
      };
    });
    const axis = range => ({ range, title: { text: "" }, showspikes: false, backgroundcolor: "#f7f9fc", gridcolor: "#dfe5ee",
      showbackground: true, zeroline: false, tickfont: { size: 10, color: "#7a869c" }, ticksuffix: " m", nticks: 5 });
    const layout = {
      margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "#fff", uirevision: "kept", legend: { orientation: "h", x: 0, y: 1, itemsizing: "constant" },
      font: { family: "system-ui, sans-serif", color: "#16213a" },
      scene: { aspectmode: "manual", aspectratio: { x: scene.aspect[0], y: scene.aspect[1], z: scene.aspect[2] }, dragmode: "orbit", xaxis: axis(scene.ranges[0]), yaxis: axis(scene.ranges[1]), zaxis: axis(scene.ranges[2]),
        camera: { eye: scene.eye, center: { x: 0, y: 0, z: -0.03 }, up: { x: 0, y: 0, z: 1 } } }
    };
    draw(view, drawn, layout, { scrollZoom: false });

    function show(f) {
      const now = traces(f);
      Plotly.restyle(view, {
        x: now.map(t => column(t.points, 0)), y: now.map(t => column(t.points, 1)), z: now.map(t => column(t.points, 2)), text: now.map(t => t.text)
      });
      position.textContent = "frame " + scene.frames[f] + ", " + scene.seconds[f].toFixed(2) + " s";
    }
    function stop() { clearInterval(timer); timer = null; play.textContent = "Play"; }

    names.checked = scene.named;
    slider.max = scene.points.length - 1;
    slider.addEventListener("input", () => { stop(); show(+slider.value); });
    names.addEventListener("change", () => {
      Plotly.restyle(view, { mode: names.checked ? "markers+text" : "markers" }, [1, 2, 3, 4]);
    });
    play.addEventListener("click", () => {
      if (timer !== null) { stop(); return; }
      play.textContent = "Pause";
      timer = setInterval(() => {
        slider.value = (+slider.value + 1) % scene.points.length;
        show(+slider.value);
      }, Math.max(40, scene.step_ms));
    });
    position.textContent = "frame " + scene.frames[0] + ", " + scene.seconds[0].toFixed(2) + " s";
  }
  for (const [id, scene] of Object.entries(data.scenes)) startScene(document.getElementById(id), scene);
})();
