// The robot in three dimensions, from its URDF. An arm without shapes is drawn as bones between its joints.
import {
  AmbientLight, CylinderGeometry, DirectionalLight, GridHelper, Mesh, MeshLambertMaterial, PerspectiveCamera, Scene, SphereGeometry,
  Vector3, WebGLRenderer, type Object3D,
} from "three";
import URDFLoader, { type URDFJoint } from "urdf-loader";
import { colour } from "./cover";
import type { Picture } from "./picture";

const EYE_M = 2.9;
const PAUSE_MS = 60;

export class Robot {
  private renderer: WebGLRenderer;
  private scene = new Scene();
  private camera = new PerspectiveCamera(35, 1, 0.1, 50);
  private robot: ReturnType<URDFLoader["parse"]>;
  private joints: URDFJoint[];
  private taxels: MeshLambertMaterial[];
  private turn_rad = -0.9;
  private size = "";
  private drawn = 0;

  static async load(canvas: HTMLCanvasElement): Promise<Robot> {
    const answer = await fetch("/urdf");
    if (!answer.ok) throw new Error(await answer.text());
    return new Robot(canvas, await answer.text());
  }

  private constructor(private canvas: HTMLCanvasElement, urdf: string) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 1.5));
    this.camera.up.set(0, 0, 1);
    const sun = new DirectionalLight(0xffffff, 2.2);
    sun.position.set(2, -3, 5);
    const grid = new GridHelper(10, 20, 0x888888, 0x999999);
    grid.rotation.x = Math.PI / 2;
    this.robot = new URDFLoader().parse(urdf);
    this.scene.add(new AmbientLight(0xffffff, 1.4), sun, grid, this.robot);
    const body = new MeshLambertMaterial({ color: 0xb8c2c8 });
    paint(this.robot, body);
    const moves = (joint: URDFJoint) => joint.jointType === "revolute" || joint.jointType === "continuous";
    this.joints = Object.values(this.robot.joints).filter(moves);
    const taxels = Object.entries(this.robot.links).filter(([name]) => /^taxel_\d+$/.test(name));
    this.taxels = taxels.map(([, link]) => {
      const material = new MeshLambertMaterial();
      paint(link, material);
      return material;
    });
    this.bones();
    canvas.addEventListener("pointermove", event => { if (event.buttons) this.turn_rad -= event.movementX * 0.01; });
  }

  private bones(): void {
    const [bone, knuckle] = [new MeshLambertMaterial({ color: 0xf2f5f6 }), new MeshLambertMaterial({ color: 0x455a64 })];
    for (const joint of this.joints) {
      joint.add(new Mesh(new SphereGeometry(0.065, 20, 14), knuckle));
      // From the joint before, or from the arm's foot, to this one.
      const length = joint.position.length();
      if (length < 0.02) continue;
      const shaft = new Mesh(new CylinderGeometry(0.05, 0.05, length, 20), bone);
      shaft.position.copy(joint.position).multiplyScalar(0.5);
      shaft.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), joint.position.clone().normalize());
      joint.parent?.add(shaft);
    }
  }

  draw(picture: Picture): void {
    // Half of the pictures are enough here, and signs of life must not wait for the graphics.
    const now = performance.now();
    if (now - this.drawn < PAUSE_MS) return;
    this.drawn = now;
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement!;
    if (!width || !height) return;
    if (this.size !== `${width} ${height}`) {
      this.size = `${width} ${height}`;
      this.renderer.setSize(width, height);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    const [x = 0, y = 0, yaw = 0] = picture.pose;
    this.robot.position.set(x, y, 0);
    this.robot.rotation.z = yaw;
    picture.joints.forEach((angle, i) => this.joints[i]?.setJointValue(angle));
    this.taxels.forEach((material, i) => {
      const known = picture.live && picture.status[i] === 0;
      material.color.set(known ? colour(picture.force_n[i] ?? 0) : "#546e7a");
    });
    const eye = EYE_M * Math.max(1, (0.9 * height) / width);
    this.camera.position.set(x + eye * Math.cos(this.turn_rad), y + eye * Math.sin(this.turn_rad), 1.7);
    this.camera.lookAt(x, y, 0.6);
    this.renderer.render(this.scene, this.camera);
  }
}

function paint(object: Object3D, material: MeshLambertMaterial): void {
  object.traverse(part => { if (part instanceof Mesh) part.material = material; });
}
