// The slice: a plane through the model, and the field's values in it. While it
// is dragged, pictures of few pixels are fetched one after another, always of
// where it is by then; at rest one of many.
import { Vector3 } from "three";

import * as api from "./api.js";

const MOVING = 128;
const RESTING = 384;
const REST = 160;

export class Slice {
	on = false;
	cut = true;
	azimuth = -Math.PI / 2;    // of the normal, about z, from x
	tilt = 0;                  // of the normal, out of the plane of x and y
	offset = 0;                // along the normal, from the origin
	step = 0.1;                // between iso-lines
	#busy = false;
	#again = false;
	#timer = null;
	#tries = 0;

	/* trouble(error): the daemon refuses, or has failed again and again.
	 * target() is {id, etag, iso}, or null while there is no scene. */
	constructor(viewport, target, trouble) {
		this.viewport = viewport;
		this.target = target;
		this.trouble = trouble;
		this.moved = () => {};
	}

	get normal() {
		const c = Math.cos(this.tilt);
		return new Vector3(c * Math.cos(this.azimuth), c * Math.sin(this.azimuth),
			Math.sin(this.tilt));
	}

	/* Offsets within the model: {min, max}. */
	get range() {
		const n = this.normal;
		const { min, max } = this.viewport.box;
		const half = max.clone().sub(min).multiplyScalar(0.5);
		const reach = 1.05 * (Math.abs(n.x) * half.x + Math.abs(n.y) * half.y +
			Math.abs(n.z) * half.z);
		const middle = n.dot(min.clone().add(max).multiplyScalar(0.5));
		return { min: middle - reach, max: middle + reach };
	}

	/* The wire contract's axes: up' across the normal, right = up' × normal. */
	get place() {
		const normal = this.normal;
		const { min, max } = this.viewport.box;
		const middle = min.clone().add(max).multiplyScalar(0.5);
		const half = max.clone().sub(min).multiplyScalar(0.5);
		const up = Math.abs(normal.z) > 0.99 ? new Vector3(0, 1, 0)
			: new Vector3(0, 0, 1);
		up.addScaledVector(normal, -up.dot(normal)).normalize();
		const right = new Vector3().crossVectors(up, normal);
		const across = (d) => Math.abs(d.x) * half.x + Math.abs(d.y) * half.y +
			Math.abs(d.z) * half.z;
		return { normal, up, right,
			center: middle.addScaledVector(normal, this.offset - normal.dot(middle)),
			extent: 2.3 * Math.max(across(up), across(right)) };
	}

	/* On or off, along one of the axes or as it was. */
	show(on) {
		this.on = on && Boolean(this.viewport.box);
		if (this.on && !this.placed)
			this.centre();
		this.placed ||= this.on;
		this.update(false);
	}

	centre() {
		const { min, max } = this.range;
		const middle = (min + max) / 2;
		this.offset = Math.abs(middle) < 1e-4 * (max - min) ? 0 : middle;
	}

	turn(azimuth, tilt) {
		this.azimuth = azimuth;
		this.tilt = tilt;
		this.centre();
		this.update(false);
	}

	move(offset, moving) {
		const { min, max } = this.range;
		this.offset = Math.min(max, Math.max(min, offset));
		this.update(moving);
	}

	/* The plane is elsewhere, or the field another. */
	update(moving) {
		this.viewport.setSlicePlace(this.on ? this.place : null, this.cut);
		this.moved();
		clearTimeout(this.#timer);
		if (!this.on)
			return;
		this.#timer = setTimeout(() => this.#fetch(RESTING), moving ? REST : 0);
		if (moving)
			this.#fetch(MOVING);
	}

	async #fetch(pixels) {
		const target = this.target();
		if (!this.on || !target)
			return;
		if (this.#busy) {
			this.#again = Math.max(this.#again || 0, pixels);
			return;
		}
		this.#busy = true;
		try {
			const place = this.place;
			const picture = await api.slice(target.id, {
				center: place.center.toArray(), normal: place.normal.toArray(),
				up: place.up.toArray(), extent: place.extent,
				width: pixels, height: pixels, iso: target.iso }, {});
			if (this.on) {
				this.viewport.setSlicePicture(place, picture, target.iso, this.step);
				this.pictures = (this.pictures ?? 0) + 1;
				this.pixels = pixels;
				this.values = picture.values;
			}
			this.#tries = 0;
		} catch (error) {
			if (error instanceof api.Problem)
				this.#failed(error);
			else if (!(error instanceof api.Offline))
				throw error;
		} finally {
			this.#busy = false;
			const again = this.#again;
			this.#again = false;
			if (again)
				this.#fetch(again);
		}
	}

	/* Once more, where that may help. */
	#failed(error) {
		if (error.status === 404 || error.status === 412)
			return;
		if (error.status < 500 || ++this.#tries > 5) {
			this.#tries = 0;
			this.trouble(error);
			return;
		}
		clearTimeout(this.#timer);
		this.#timer = setTimeout(() => this.#fetch(RESTING), 400 * this.#tries);
	}
}
