// SPDX-License-Identifier: Apache-2.0
// A robot in three dimensions out of its URDF: links with their own shapes, joints that can be set.

import * as THREE from 'three';

const numbers = (text, missing) => (text ? text.trim().split(/\s+/).map(Number) : missing);

// URDF: p' = Rz(yaw) Ry(pitch) Rx(roll) p + xyz
function place(object, origin) {
  object.position.set(...numbers(origin?.getAttribute('xyz'), [0, 0, 0]));
  const [roll, pitch, yaw] = numbers(origin?.getAttribute('rpy'), [0, 0, 0]);
  object.quaternion.setFromEuler(new THREE.Euler(roll, pitch, yaw, 'ZYX'));
}

function shape(geometry) {
  const element = geometry?.firstElementChild;
  const number = (name) => Number(element.getAttribute(name));
  switch (element?.tagName) {
    case 'box':
      return new THREE.BoxGeometry(...numbers(element.getAttribute('size')));
    case 'cylinder': // along z in URDF, along y in three
      return new THREE.CylinderGeometry(number('radius'), number('radius'), number('length'), 48)
        .rotateX(Math.PI / 2);
    case 'sphere':
      return new THREE.SphereGeometry(number('radius'), 32, 16);
    default:
      return null;
  }
}

function visual(element) {
  const geometry = shape(element.querySelector('geometry'));
  if (geometry === null) return null;
  const colour = numbers(element.querySelector('color')?.getAttribute('rgba'), [0.6, 0.6, 0.6, 1]);
  const material = new THREE.MeshLambertMaterial({
    color: new THREE.Color().setRGB(...colour.slice(0, 3), THREE.SRGBColorSpace),
    transparent: true,
    opacity: 0.72 * colour[3], // the shapes of neighbouring links overlap
    depthWrite: false,
  });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.add(new THREE.LineSegments(
    new THREE.EdgesGeometry(geometry, 30), new THREE.LineBasicMaterial({ color: 0x333333 })));
  place(mesh, element.querySelector('origin'));
  return mesh;
}

// `root` is the tree of links; `set(positions)` takes m or rad by joint name, mimics follow.
export class Robot {
  constructor(text) {
    const robot = new DOMParser().parseFromString(text, 'application/xml').documentElement;
    const links = {};
    for (const element of robot.querySelectorAll(':scope > link')) {
      const link = new THREE.Group();
      link.name = element.getAttribute('name');
      for (const part of element.querySelectorAll(':scope > visual')) {
        const mesh = visual(part);
        if (mesh !== null) link.add(mesh);
      }
      links[link.name] = link;
    }
    const children = new Set();
    this.joints = {};
    for (const element of robot.querySelectorAll(':scope > joint')) {
      const joint = new THREE.Group();
      joint.name = element.getAttribute('name');
      place(joint, element.querySelector('origin'));
      const child = links[element.querySelector('child').getAttribute('link')];
      children.add(child.name);
      joint.add(child);
      links[element.querySelector('parent').getAttribute('link')].add(joint);
      const mimic = element.querySelector('mimic');
      this.joints[joint.name] = {
        kind: element.getAttribute('type'),
        axis: new THREE.Vector3(
          ...numbers(element.querySelector('axis')?.getAttribute('xyz'), [1, 0, 0])).normalize(),
        frame: joint,
        moved: child,
        mimic: mimic && {
          joint: mimic.getAttribute('joint'),
          multiplier: Number(mimic.getAttribute('multiplier') ?? 1),
          offset: Number(mimic.getAttribute('offset') ?? 0),
        },
      };
    }
    this.links = links;
    this.root = Object.values(links).find((link) => !children.has(link.name));
  }

  set(positions) {
    for (const [name, joint] of Object.entries(this.joints)) {
      const leader = joint.mimic;
      const value = leader
        ? leader.multiplier * (positions[leader.joint] ?? 0) + leader.offset
        : positions[name] ?? 0;
      if (joint.kind === 'prismatic') {
        joint.moved.position.copy(joint.axis).multiplyScalar(value);
      } else if (joint.kind === 'revolute' || joint.kind === 'continuous') {
        joint.moved.quaternion.setFromAxisAngle(joint.axis, value);
      }
    }
  }
}

const ARROW_COLOUR = 0xb5401f;
const ARROW_M = 0.35; // length of the greatest force in the recording
const ARC_M = 0.24; // radius of the arc of a torque
const GREATEST_ARC = 1.5 * Math.PI; // arc of the greatest torque in the recording, rad

// The force (straight) or torque (round) of a motor at its joint; `set` takes -1 to 1 of the greatest.
export class ForceArrow {
  constructor(joint) {
    this.round = joint.kind !== 'prismatic';
    this.material = new THREE.MeshBasicMaterial({
      color: ARROW_COLOUR, transparent: true, depthTest: false, // seen through the links
    });
    this.body = new THREE.Mesh(new THREE.BufferGeometry(), this.material);
    this.tip = new THREE.Mesh(new THREE.ConeGeometry(0.028, 0.07, 20), this.material);
    this.object = new THREE.Group();
    this.object.add(this.body, this.tip);
    this.body.renderOrder = this.tip.renderOrder = 1;
    // z of the arrow along the joint's axis
    this.object.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), joint.axis);
    (this.round ? joint.frame : joint.moved).add(this.object);
  }

  set(share) {
    const size = Math.min(Math.abs(share), 1);
    this.object.visible = size > 0.005;
    if (!this.object.visible) return;
    this.body.geometry.dispose();
    const turn = Math.sign(share);
    if (this.round) {
      const arc = size * GREATEST_ARC;
      this.body.geometry = new THREE.TorusGeometry(ARC_M, 0.009, 10, 48, arc);
      this.body.scale.set(1, turn, 1);
      this.tip.position.set(ARC_M * Math.cos(arc), turn * ARC_M * Math.sin(arc), 0);
      this.tip.rotation.set(0, 0, turn > 0 ? arc : Math.PI - arc);
    } else {
      this.body.geometry = new THREE.CylinderGeometry(0.009, 0.009, size * ARROW_M, 12)
        .rotateX(Math.PI / 2).translate(0, 0, turn * size * ARROW_M / 2);
      this.tip.position.set(0, 0, turn * size * ARROW_M);
      this.tip.rotation.set(turn * Math.PI / 2, 0, 0);
    }
  }
}
