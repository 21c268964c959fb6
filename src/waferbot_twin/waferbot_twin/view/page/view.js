// SPDX-License-Identifier: Apache-2.0
// The page: loads the recording, draws plots and machine, and keeps one time for all of them.

import * as THREE from 'three';
import { OrbitControls } from './vendor/OrbitControls.js';
import { ForceArrow, Robot } from './robot.js';

const $ = (id) => document.getElementById(id);

async function load(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address}: ${answer.status} ${answer.statusText}`);
  return answer.json();
}

// ---- machine --------------------------------------------------------------------------------

class Machine {
  constructor(recording) {
    this.robot = new Robot(recording.urdf);
    this.arrows = recording.axes.map((axis) => ({
      arrow: new ForceArrow(this.robot.joints[axis.name]),
      greatest: Math.max(...axis.force.map(Math.abs), 1e-9),
    }));
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    $('machine').append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0xf4f5f7);
    this.scene.add(this.robot.root, new THREE.HemisphereLight(0xffffff, 0x999999, 2.2));
    const light = new THREE.DirectionalLight(0xffffff, 1.6);
    light.position.set(2, -3, 4);
    this.scene.add(light);
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener('change', () => this.draw());
    const box = new THREE.Box3().setFromObject(this.robot.root);
    const ball = box.getBoundingSphere(new THREE.Sphere());
    const grid = new THREE.GridHelper(4, 16, 0xbbbbbb, 0xdddddd);
    grid.rotation.x = Math.PI / 2;
    grid.position.z = box.min.z;
    this.scene.add(grid);
    this.controls.target.copy(ball.center);
    this.camera.position.copy(ball.center)
      .add(new THREE.Vector3(0.75, -1.6, 0.8).setLength(3.4 * ball.radius));
    this.controls.update();
    new ResizeObserver(() => this.resize()).observe($('machine'));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = $('machine');
    if (!width || !height) return;
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  show(axes) {
    this.robot.set(Object.fromEntries(axes.map((axis) => [axis.name, axis.position])));
    axes.forEach((axis, place) => {
      const { arrow, greatest } = this.arrows[place];
      arrow.set(axis.force / greatest);
    });
    this.draw();
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
  }
}

// ---- plots ----------------------------------------------------------------------------------

const cursor = { sync: { key: 'waferbot', scales: ['x', null] }, drag: { x: true, y: false }, y: false };

class Plots {
  constructor(recording, curves, onTime, onRange) {
    this.recording = recording;
    this.onTime = onTime;
    this.onRange = onRange;
    this.curves = curves;
    this.range = [0, recording.duration];
    this.shown = [];
    new ResizeObserver(() => this.resize()).observe($('plots'));
  }

  size() {
    const { clientWidth: width, clientHeight: height } = $('plots');
    const count = this.shown.length || 1;
    return { width, height: Math.max(height / count - 62, 60) }; // title and legend take 62 px
  }

  choose(axis) {
    for (const { plot } of this.shown) plot.destroy();
    this.shown = [];
    const places = this.recording.plots
      .map((plot, place) => [plot, place]).filter(([plot]) => plot.axis === axis);
    this.shown = places.map(([own, place]) => this.make(own, place));
    this.resize();
  }

  make(own, place) {
    const line = document.createElement('div');
    line.className = 'now-line';
    const plot = new uPlot({
      ...this.size(),
      title: own.title,
      cursor: { ...cursor, bind: { dblclick: () => () => this.onRange(0, this.recording.duration) } },
      scales: { x: { time: false, range: () => this.range } },
      axes: [{ values: (_, marks) => marks.map((mark) => `${+mark.toPrecision(6)} s`) }, { size: 64 }],
      series: [
        { label: 'time', value: (_, value) => (value == null ? '–' : `${value.toFixed(5)} s`) },
        ...own.curves.map((curve) => ({
          label: curve.label,
          stroke: curve.colour,
          width: 1.2,
          points: { show: false },
          spanGaps: true,
          paths: curve.held ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear(),
          value: (drawn, _, series, index) => valueAt(drawn.data[0], drawn.data[series], index),
        })),
      ],
      hooks: {
        ready: [(drawn) => {
          drawn.over.append(line);
          drawn.over.addEventListener('click', () => this.click(drawn));
        }],
        setSelect: [(drawn) => this.select(drawn)],
        setSize: [() => this.mark(this.now ?? 0)],
      },
    }, this.data(place), $('plots'));
    return { plot, line, place };
  }

  data(place) {
    return uPlot.join(this.curves[place].map(([time, values]) => [time, values]));
  }

  click(drawn) {
    if (drawn.select.width < 3) this.onTime(drawn.posToVal(drawn.cursor.left, 'x'));
  }

  select(drawn) {
    const { left, width } = drawn.select;
    if (width < 3) return;
    drawn.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.onRange(drawn.posToVal(left, 'x'), drawn.posToVal(left + width, 'x'));
  }

  update(curves, range) {
    this.curves = curves;
    this.range = range;
    for (const { plot, place } of this.shown) plot.setData(this.data(place));
    this.mark(this.now ?? 0);
  }

  resize() {
    const size = this.size();
    if (size.width > 0) for (const { plot } of this.shown) plot.setSize(size);
    this.mark(this.now ?? 0);
  }

  mark(time) {
    this.now = time;
    for (const { plot, line } of this.shown) {
      const left = plot.valToPos(time, 'x');
      line.hidden = !(left >= 0 && left <= plot.over.clientWidth);
      line.style.left = `${left}px`;
    }
  }
}

// The curves of a plot have times of their own; between them, the last value holds.
function valueAt(times, values, index) {
  if (index == null) return '–';
  while (index > 0 && values[index] == null) index -= 1;
  return values[index] == null ? '–' : `${+values[index].toPrecision(5)}`;
}

// ---- time -----------------------------------------------------------------------------------

function interpolated(times, values, time) {
  const step = times[1] - times[0];
  const place = Math.min(Math.max(time / step, 0), times.length - 1);
  const before = Math.min(Math.floor(place), times.length - 2);
  const part = place - before;
  return values[before] + part * (values[before + 1] - values[before]);
}

// What the parts bore in the stretch that a time is in: the plant tells it at the stretch's end.
class Loads {
  constructor(recording) {
    this.ends = recording.load_ends;
    this.loads = recording.loads;
    $('loads').hidden = !this.loads.length;
    this.rows = this.loads.map((load) => {
      const row = $('loads').querySelector('tbody').insertRow();
      for (const text of [load.place, load.what, '', load.range]) row.insertCell().textContent = text;
      return row;
    });
  }

  show(time) {
    if (!this.loads.length) return;
    let [low, high] = [0, this.ends.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.ends[middle] < time) low = middle + 1;
      else high = middle;
    }
    this.loads.forEach((load, place) => {
      const [least, most] = [load.least[low], load.most[low]].map((value) => `${+value.toPrecision(4)}`);
      const row = this.rows[place];
      row.cells[2].textContent = `${least === most ? least : `${least} to ${most}`} ${load.unit}`;
      row.className = load.outside[low] ? 'outside' : '';
    });
  }
}

class View {
  constructor(recording, curves) {
    this.recording = recording;
    this.playing = false;
    this.plots = new Plots(recording, curves, (time) => this.seek(time),
      (start, end) => this.look(start, end));
    $('name').textContent = recording.name;
    $('subtitle').textContent = recording.subtitle;
    document.title = `${recording.name} – waferbot`;
    try {
      this.machine = new Machine(recording);
    } catch (error) {
      console.warn(error);
      $('no-machine').hidden = false;
    }
    this.loads = new Loads(recording);
    this.rows = recording.axes.map((axis) => {
      const row = $('values').tBodies[0].insertRow();
      for (const text of [axis.title, '', axis.force_name, '']) row.insertCell().textContent = text;
      return row;
    });
    for (const axis of recording.axes) {
      const button = document.createElement('button');
      button.type = 'button';
      button.textContent = axis.title;
      button.dataset.axis = axis.name;
      button.addEventListener('click', () => this.choose(axis.name));
      $('axes').append(button);
    }
    $('time').max = recording.duration;
    $('time').addEventListener('input', () => this.seek(Number($('time').value)));
    $('play').addEventListener('click', () => this.play(!this.playing));
    document.addEventListener('keydown', (event) => {
      if (event.code === 'Space' && !/BUTTON|SELECT/.test(event.target.tagName)) {
        event.preventDefault();
        this.play(!this.playing);
      }
    });
    this.choose((recording.axes.find((axis) => axis.moves) ?? recording.axes[0]).name);
    this.seek(0);
  }

  choose(axis) {
    for (const button of $('axes').children) {
      button.setAttribute('aria-pressed', button.dataset.axis === axis);
    }
    this.plots.choose(axis);
  }

  axesAt(time) {
    return this.recording.axes.map((axis) => ({
      ...axis,
      position: interpolated(this.recording.time, axis.position, time),
      force: interpolated(this.recording.time, axis.force, time),
    }));
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.recording.duration);
    const axes = this.axesAt(this.time);
    $('time').value = this.time;
    $('now').textContent = `${this.time.toFixed(4)} s`;
    axes.forEach((axis, place) => {
      const cells = this.rows[place].cells;
      const [scale, prefix] = axis.unit === 'm' ? [1e3, 'mm'] : [180 / Math.PI, '°'];
      cells[1].textContent = `${(scale * axis.position).toFixed(4)} ${prefix}`;
      cells[3].textContent = `${axis.force.toFixed(2)} ${axis.force_unit}`;
    });
    this.loads.show(this.time);
    this.plots.mark(this.time);
    this.machine?.show(axes);
  }

  async look(start, end) {
    const range = [Math.max(start, 0), Math.min(end, this.recording.duration)];
    this.asked = range;
    const curves = await load(`curves.json?from=${range[0]}&to=${range[1]}`);
    if (this.asked === range) this.plots.update(curves, range);
  }

  play(on) {
    this.playing = on;
    $('play').textContent = on ? 'Pause' : 'Play';
    if (!on) return;
    if (this.time >= this.recording.duration) this.seek(0);
    let before = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      this.seek(this.time + Math.max(now - before, 0) / 1e3 * Number($('speed').value));
      before = now;
      if (this.time >= this.recording.duration) this.play(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
}

try {
  const recording = await load('recording.json');
  const curves = await load(`curves.json?from=0&to=${recording.duration}`);
  window.waferbotView = new View(recording, curves);
  document.body.dataset.state = 'ready';
} catch (error) {
  console.error(error);
  $('error').textContent = `The recording cannot be shown: ${error.message}`;
  $('error').hidden = false;
  document.body.dataset.state = 'failed';
}
