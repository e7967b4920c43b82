// The picture: surface, floor, slice, marks; the camera and the mouse. Z is up.
import { BufferAttribute, BufferGeometry, Color, ConeGeometry, CylinderGeometry,
	DataTexture, DoubleSide, FloatType, FrontSide, GLSL3, Group, LineBasicMaterial,
	LineLoop, LineSegments, Matrix4, Mesh, MeshBasicMaterial, NearestFilter,
	PerspectiveCamera, PlaneGeometry, Raycaster, RedFormat, Scene,
	ShaderMaterial, SphereGeometry, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

import { creases } from "./crease.js";
import * as shading from "./shading.js";

export const MODES = ["colour", "normal", "zebra", "curvature"];

const loader = new GLTFLoader();

/* {geometry, report}: what a GLB has in it, Z up as in the document (the
 * file's root node turns it, which is left aside here). */
export async function parse(data) {
	const gltf = await loader.parseAsync(data, "");
	let geometry = new BufferGeometry();
	gltf.scene.traverse((object) => {
		if (object.isMesh)
			geometry = object.geometry;
	});
	if (!geometry.getAttribute("position"))
		geometry.setAttribute("position",
			new BufferAttribute(new Float32Array(0), 3));
	const count = geometry.getAttribute("position").count;
	if (!geometry.getAttribute("normal"))
		geometry.computeVertexNormals();
	geometry.setAttribute("color", plain(geometry.getAttribute("color"), count));
	const report = gltf.asset?.extras?.blobfield ?? {};
	if (report.sharp_vertices && geometry.index)
		crease(geometry);
	geometry.setAttribute("curvature", new BufferAttribute(new Float32Array(
		2 * geometry.getAttribute("position").count), 2));
	geometry.computeBoundingBox();
	return { geometry, report };
}

/* Vertices at sharp edges, one for each side. */
function crease(geometry) {
	const { position, normal, color } = geometry.attributes;
	const made = creases(geometry.index.array, position.array, normal.array);
	if (made.from.length === 0)
		return;
	const more = (array, rest) => {
		const out = new Float32Array(array.length + rest.length);
		out.set(array);
		out.set(rest, array.length);
		return new BufferAttribute(out, 3);
	};
	const copied = (array) => made.from.flatMap((v) =>
		[array[3 * v], array[3 * v + 1], array[3 * v + 2]]);
	geometry.setIndex(new BufferAttribute(made.index, 1));
	geometry.setAttribute("position",
		more(position.array, copied(position.array)));
	geometry.setAttribute("color", more(color.array, copied(color.array)));
	geometry.setAttribute("normal", more(normal.array, made.normals));
}

/* Three floats a vertex, whatever the file has. */
function plain(attribute, count) {
	const out = new Float32Array(3 * count).fill(0.8);
	for (let i = 0; attribute && i < count; i++) {
		out[3 * i] = attribute.getX(i);
		out[3 * i + 1] = attribute.getY(i);
		out[3 * i + 2] = attribute.getZ(i);
	}
	return new BufferAttribute(out, 3);
}

export class Viewport {
	/* picked(ray) after a click; slid(offset, done) while the slice's handle is
	 * dragged. */
	constructor(host, { picked, slid }) {
		this.host = host;
		this.picked = picked;
		this.slid = slid;
		this.renderer = new WebGLRenderer({ antialias: true, alpha: true });
		this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
		this.canvas = this.renderer.domElement;
		this.canvas.setAttribute("role", "application");
		this.canvas.setAttribute("aria-label",
			"The model: arrow keys turn it, plus and minus zoom");
		this.canvas.tabIndex = 0;
		host.prepend(this.canvas);
		this.canvas.addEventListener("webglcontextrestored", () => this.draw());
		this.scene = new Scene();
		this.camera = new PerspectiveCamera(34, 1, 0.01, 1000);
		this.camera.up.set(0, 0, 1);
		this.camera.position.set(3, -6, 2.7);
		this.controls = new OrbitControls(this.camera, this.canvas);
		this.controls.zoomToCursor = true;
		this.controls.addEventListener("change", () => this.draw());
		this.center = new Vector3();
		this.size = 2;
		this.fitted = false;
		this.makeSurface();
		this.makeFloor();
		this.makeMarks();
		this.makeSlice();
		this.listen();
		new ResizeObserver(() => this.resize()).observe(host);
		const scheme = matchMedia("(prefers-color-scheme: dark)");
		scheme.addEventListener("change", () => this.dress(scheme.matches));
		this.dress(scheme.matches);
		this.resize();
	}

	makeSurface() {
		this.material = new ShaderMaterial({
			glslVersion: GLSL3, side: DoubleSide,
			vertexShader: shading.surfaceVertex,
			fragmentShader: shading.surfaceFragment,
			uniforms: { mode: { value: 0 }, wire: { value: false },
				gauss: { value: false }, dark: { value: false },
				scale: { value: 1 }, cut: { value: false },
				plane: { value: { x: 0, y: 0, z: 0, w: 0 } },
				keyLight: { value: new Vector3(0, 0, 1) },
				wireColor: { value: new Color() } },
		});
		this.surface = new Mesh(new BufferGeometry(), this.material);
		this.surface.frustumCulled = false;
		this.surface.visible = false;
		this.scene.add(this.surface);
	}

	makeFloor() {
		const material = new ShaderMaterial({
			glslVersion: GLSL3, transparent: true, depthWrite: false,
			side: DoubleSide, vertexShader: shading.planeVertex,
			fragmentShader: shading.floorFragment,
			uniforms: { cell: { value: 1 }, reach: { value: 1 },
				center: { value: new Vector3() }, ink: { value: new Color() } },
		});
		this.floor = new Mesh(new PlaneGeometry(2, 2), material);
		this.floor.visible = false;
		this.floor.renderOrder = -1;
		this.scene.add(this.floor);
	}

	makeMarks() {
		const lines = (opacity, depthTest) => new LineSegments(new BufferGeometry(),
			new LineBasicMaterial({ transparent: true, opacity, depthTest,
				depthWrite: false }));
		this.skeleton = new Group();
		this.skeleton.add(lines(0.6, false), lines(1, true));
		this.skeleton.children.forEach((l) => {
			l.frustumCulled = false;
			l.renderOrder = 3;
		});
		this.scene.add(this.skeleton);
		this.pin = new Group();
		this.pin.visible = false;
		this.pinMaterial = new MeshBasicMaterial({ depthTest: false,
			transparent: true });
		const ball = new Mesh(new SphereGeometry(1, 20, 14), this.pinMaterial);
		const needle = new Mesh(new CylinderGeometry(0.22, 0.22, 9, 8)
			.translate(0, 4.5, 0), this.pinMaterial);
		const tip = new Mesh(new ConeGeometry(0.75, 2.2, 16)
			.translate(0, 10, 0), this.pinMaterial);
		this.pin.add(ball, needle, tip);
		this.pin.children.forEach((m) => { m.renderOrder = 5; });
		this.scene.add(this.pin);
	}

	makeSlice() {
		this.sliceMaterial = new ShaderMaterial({
			glslVersion: GLSL3, transparent: true, side: DoubleSide,
			depthWrite: false, vertexShader: shading.planeVertex,
			fragmentShader: shading.sliceFragment,
			uniforms: { field: { value: null }, iso: { value: 0.5 },
				step_: { value: 0.1 }, dark: { value: false } },
		});
		this.section = new Mesh(new PlaneGeometry(1, 1), this.sliceMaterial);
		this.section.visible = false;
		this.section.matrixAutoUpdate = false;
		this.section.renderOrder = 1;
		this.frame = new Group();
		this.frame.visible = false;
		this.frame.matrixAutoUpdate = false;
		this.frameMaterial = new LineBasicMaterial({ transparent: true,
			opacity: 0.8 });
		const edge = new LineLoop(new BufferGeometry().setFromPoints(
			[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(([x, y]) =>
				new Vector3(x, y, 0))), this.frameMaterial);
		edge.renderOrder = 2;
		this.frame.add(edge);
		this.handleMaterial = new MeshBasicMaterial({ depthTest: false,
			transparent: true, opacity: 0.95 });
		this.handle = new Group();
		for (const side of [1, -1]) {
			const shaft = new Mesh(new CylinderGeometry(0.16, 0.16, 3, 12)
				.translate(0, 1.9, 0), this.handleMaterial);
			const head = new Mesh(new ConeGeometry(0.62, 1.5, 20)
				.translate(0, 4, 0), this.handleMaterial);
			const arm = new Group();
			arm.add(shaft, head);
			arm.rotation.x = side * Math.PI / 2;
			this.handle.add(arm);
		}
		this.handle.add(new Mesh(new SphereGeometry(0.62, 20, 14),
			this.handleMaterial));
		this.handle.traverse((o) => { o.renderOrder = 4; });
		this.grip = new Mesh(new CylinderGeometry(1.5, 1.5, 11, 10)
			.rotateX(Math.PI / 2), new MeshBasicMaterial({ visible: false }));
		this.handle.add(this.grip);
		this.handle.visible = false;
		this.scene.add(this.section, this.frame, this.handle);
		this.slice = null;
	}

	/* Colours of the light or dark scheme, from the style sheet. */
	dress(dark) {
		const style = getComputedStyle(this.host);
		const color = (name) => new Color(style.getPropertyValue(name).trim());
		this.dark = dark;
		this.material.uniforms.dark.value = dark;
		this.sliceMaterial.uniforms.dark.value = dark;
		this.material.uniforms.wireColor.value = color("--wire");
		this.floor.material.uniforms.ink.value
			.set(style.getPropertyValue("--floor").trim()).convertLinearToSRGB();
		for (const lines of this.skeleton.children)
			lines.material.color = color("--second");
		this.pinMaterial.color = color("--pin");
		this.handleMaterial.color = color("--pin");
		this.frameMaterial.color = color("--accent");
		this.draw();
	}

	resize() {
		const { clientWidth: w, clientHeight: h } = this.host;
		if (w === 0 || h === 0)
			return;
		this.renderer.setSize(w, h, false);
		this.camera.aspect = w / h;
		this.camera.updateProjectionMatrix();
		this.draw();
	}

	/* Draws once, soon, however often it is asked. */
	draw() {
		this.frameRequest ??= requestAnimationFrame(() => {
			this.frameRequest = null;
			this.paint();
		});
	}

	paint() {
		const camera = this.camera;
		const distance = camera.position.distanceTo(this.center);
		camera.near = Math.max(distance - 12 * this.size, distance * 0.01);
		camera.far = distance + 40 * this.size;
		camera.updateProjectionMatrix();
		// From over the camera's left shoulder.
		this.material.uniforms.keyLight.value.set(-0.55, 0.75, 0.65)
			.transformDirection(camera.matrixWorld);
		// Back faces show past silhouettes, if only just: only where they are meant.
		this.material.side = this.material.uniforms.cut.value ||
			this.box?.containsPoint(camera.position) ? DoubleSide : FrontSide;
		this.floor.visible = this.fitted && camera.position.z > this.floor.position.z;
		const at = (object, pixels) => object.scale.setScalar(pixels *
			this.pixel(object.position));
		at(this.pin, 4);
		at(this.handle, 14);
		this.renderer.render(this.scene, camera);
		this.frames = (this.frames ?? 0) + 1;
	}

	/* How long a pixel is, there. */
	pixel(position) {
		const depth = position.clone().sub(this.camera.position)
			.dot(this.camera.getWorldDirection(new Vector3()));
		return 2 * Math.max(depth, 1e-9) *
			Math.tan(this.camera.fov * Math.PI / 360) / this.host.clientHeight;
	}

	/* Another surface in the same picture: the camera stays, but for the first. */
	setGeometry(geometry) {
		this.shared?.dispose();
		this.shared = geometry;
		this.separate?.dispose();
		this.separate = null;
		const box = geometry.boundingBox;
		this.empty = geometry.getAttribute("position").count === 0;
		this.surface.visible = !this.empty;
		if (!this.empty) {
			box.getCenter(this.center);
			this.box = box.clone();
			this.size = Math.max(box.getSize(new Vector3()).length(), 1e-6);
			if (!this.fitted)
				this.fit();
			else
				this.placeFloor();
		}
		this.chooseGeometry();
	}

	/* Lines between triangles need triangles of their own. */
	chooseGeometry() {
		const wire = this.material.uniforms.wire.value;
		if (wire && this.shared && !this.separate)
			this.separate = this.shared.index ? this.shared.toNonIndexed()
				: this.shared.clone();
		if (this.shared)
			this.surface.geometry = wire ? this.separate : this.shared;
		this.draw();
	}

	setMode(mode) {
		this.material.uniforms.mode.value = MODES.indexOf(mode);
		this.draw();
	}

	setWire(on) {
		this.material.uniforms.wire.value = on;
		this.chooseGeometry();
	}

	/* Curvatures of the vertices, mean and Gaussian by turns. */
	setCurvature(values) {
		this.shared.setAttribute("curvature", new BufferAttribute(values, 2));
		this.separate?.dispose();
		this.separate = null;
		this.chooseGeometry();
	}

	setCurvatureScale(scale, gauss) {
		this.material.uniforms.scale.value = scale;
		this.material.uniforms.gauss.value = gauss;
		this.draw();
	}

	/* The whole surface in the picture, from where the camera is, or from a
	 * direction. */
	fit(direction) {
		if (!this.box)
			return;
		const towards = direction ? new Vector3(...direction)
			: this.fitted ? this.camera.position.clone().sub(this.controls.target)
				: new Vector3(1, -2, 0.9);
		towards.normalize();
		this.controls.target.copy(this.center);
		const across = Math.min(1, this.camera.aspect);
		const distance = 0.5 * this.size /
			Math.sin(this.camera.fov * Math.PI / 360) / across * 0.94;
		this.camera.position.copy(this.center).addScaledVector(towards, distance);
		this.controls.update();
		this.fitted = true;
		this.floorSize = 0;
		this.placeFloor();
		this.draw();
	}

	/* Below the model; as large as that, but for small changes of its size. */
	placeFloor() {
		this.floor.position.z = this.box.min.z - 0.004 * this.size;
		if (Math.abs(Math.log(this.size / this.floorSize)) < 0.3)
			return;
		this.floorSize = this.size;
		const reach = 1.9 * this.size;
		this.floor.position.x = this.center.x;
		this.floor.position.y = this.center.y;
		this.floor.scale.set(reach, reach, 1);
		const uniforms = this.floor.material.uniforms;
		uniforms.cell.value = 10 ** Math.floor(Math.log10(this.size / 3)) *
			(this.size / 3 / 10 ** Math.floor(Math.log10(this.size / 3)) > 4 ? 1 : 0.5);
		uniforms.reach.value = reach;
		uniforms.center.value.copy(this.center);
	}

	/* Lines of the selected node: [x, y, z, …]. */
	setSkeleton(points) {
		for (const lines of this.skeleton.children) {
			lines.geometry.dispose();
			lines.geometry = new BufferGeometry().setAttribute("position",
				new BufferAttribute(new Float32Array(points), 3));
		}
		this.draw();
	}

	/* A pin in the surface; none for null. */
	setPin(position, normal) {
		this.pin.visible = position !== null;
		if (position) {
			this.pin.position.set(...position);
			const n = new Vector3(...normal ?? [0, 0, 0]);
			this.pin.children.slice(1).forEach((m) => {
				m.visible = n.lengthSq() > 0;
			});
			if (n.lengthSq() > 0)
				this.pin.quaternion.setFromUnitVectors(new Vector3(0, 1, 0),
					n.normalize());
		}
		this.draw();
	}

	/* Where the slice is to be: {center, right, up, normal, extent}, or null.
	 * Its picture comes later. */
	setSlicePlace(place, cut) {
		this.slice = place;
		this.frame.visible = this.handle.visible = place !== null;
		if (!place)
			this.section.visible = false;
		else {
			this.frame.matrix.copy(matrix(place));
			this.handle.position.copy(place.center);
			this.handle.quaternion.setFromUnitVectors(new Vector3(0, 0, 1),
				place.normal);
		}
		const uniforms = this.material.uniforms;
		uniforms.cut.value = cut && place !== null;
		if (place) {
			const { x, y, z } = place.normal;
			uniforms.plane.value = { x, y, z, w: place.normal.dot(place.center) +
				1e-4 * this.size };
		}
		this.draw();
	}

	/* The field's values in a plane, shown where they were computed. */
	setSlicePicture(place, { width, height, values }, iso, step) {
		this.sliceMaterial.uniforms.field.value?.dispose();
		const texture = new DataTexture(values, width, height, RedFormat, FloatType);
		texture.minFilter = texture.magFilter = NearestFilter;
		texture.needsUpdate = true;
		this.sliceMaterial.uniforms.field.value = texture;
		this.sliceMaterial.uniforms.iso.value = iso;
		this.sliceMaterial.uniforms.step_.value = step;
		this.section.matrix.copy(matrix(place));
		this.section.visible = this.slice !== null;
		this.draw();
	}

	ray(event) {
		const box = this.canvas.getBoundingClientRect();
		const caster = new Raycaster();
		caster.setFromCamera(new Vector2(
			2 * (event.clientX - box.left) / box.width - 1,
			1 - 2 * (event.clientY - box.top) / box.height), this.camera);
		return caster;
	}

	listen() {
		let down = null;
		const gripped = (event) => this.handle.visible &&
			this.ray(event).intersectObject(this.grip).length > 0;
		this.canvas.addEventListener("pointerdown", (event) => {
			// Further fingers neither move the slice nor pick.
			if (down?.grip !== undefined)
				return event.stopImmediatePropagation();
			down = { x: event.clientX, y: event.clientY, button: down ? -1
				: event.button, id: event.pointerId };
			if (event.button === 0 && gripped(event)) {
				down.grip = this.along(event) - this.offset();
				this.controls.enabled = false;
				this.canvas.setPointerCapture(event.pointerId);
				event.stopImmediatePropagation();
			}
		}, true);
		this.canvas.addEventListener("pointermove", (event) => {
			if (down?.grip !== undefined) {
				if (event.pointerId === down.id && this.slice)
					this.slid(this.along(event) - down.grip, false);
			} else if (event.buttons === 0)
				this.canvas.classList.toggle("grip", gripped(event));
		});
		const up = (event) => {
			const was = down;
			if (was?.grip !== undefined && was.id !== event.pointerId)
				return;
			down = null;
			if (was?.grip !== undefined) {
				this.controls.enabled = true;
				if (this.slice)
					this.slid(this.along(event) - was.grip, true);
			} else if (event.type === "pointerup" && was?.button === 0 && Math.hypot(event.clientX - was.x,
				event.clientY - was.y) < 4) {
				this.picked(this.ray(event).ray);
			}
		};
		this.canvas.addEventListener("keydown", (event) => this.key(event));
		this.canvas.addEventListener("pointerup", up);
		this.canvas.addEventListener("pointercancel", up);
	}

	/* Round the model by the arrow keys, nearer and farther by + and -. */
	key(event) {
		const [turn, rise, nearer] = { ArrowLeft: [-1, 0, 1], ArrowRight: [1, 0, 1],
			ArrowUp: [0, 1, 1], ArrowDown: [0, -1, 1], "+": [0, 0, 0.9],
			"=": [0, 0, 0.9], "-": [0, 0, 1 / 0.9] }[event.key] ?? [];
		if (turn === undefined || event.ctrlKey || event.metaKey || event.altKey)
			return;
		event.preventDefault();
		const { target } = this.controls;
		const { x, y, z } = this.camera.position.clone().sub(target);
		const across = Math.hypot(x, y);
		const length = nearer * Math.hypot(across, z);
		const a = Math.atan2(y, x) + turn * Math.PI / 24;
		const h = Math.min(1.55, Math.max(-1.55, Math.atan2(z, across) +
			rise * Math.PI / 24));
		this.camera.position.set(length * Math.cos(h) * Math.cos(a),
			length * Math.cos(h) * Math.sin(a), length * Math.sin(h)).add(target);
		this.controls.update();
		this.draw();
	}

	offset() {
		return this.slice.center.dot(this.slice.normal);
	}

	/* Where along the slice's normal the mouse is: the place of the line
	 * through the slice's centre that is nearest to the mouse's ray. */
	along(event) {
		const { origin, direction } = this.ray(event).ray;
		const { center, normal } = this.slice;
		const w = center.clone().sub(origin);
		const b = normal.dot(direction);
		const d = 1 - b * b;
		return this.offset() + (d < 1e-3 ? 0
			: (b * direction.dot(w) - normal.dot(w)) / d);
	}

	/* For renderings by the daemon. */
	get view() {
		return { eye: this.camera.position.toArray(),
			target: this.controls.target.toArray(), up: [0, 0, 1],
			fov: this.camera.fov * Math.PI / 180 };
	}
}

/* What is left of it without WebGL: sizes, no picture. */
export class Blind {
	material = { uniforms: { wire: { value: false } } };
	size = 2;
	empty = true;
	fitted = true;

	setGeometry(geometry) {
		this.empty = geometry.getAttribute("position").count === 0;
		if (this.empty)
			return;
		this.box = geometry.boundingBox;
		this.center = this.box.getCenter(new Vector3());
		this.size = Math.max(this.box.getSize(new Vector3()).length(), 1e-6);
	}

	setWire(on) {
		this.material.uniforms.wire.value = on;
	}

	fit() {}
	setMode() {}
	setCurvature() {}
	setCurvatureScale() {}
	setSkeleton() {}
	setPin() {}
	setSlicePlace() {}
	setSlicePicture() {}
}

function matrix({ center, right, up, normal, extent }) {
	return new Matrix4().makeBasis(right.clone().multiplyScalar(extent),
		up.clone().multiplyScalar(extent), normal).setPosition(center);
}
