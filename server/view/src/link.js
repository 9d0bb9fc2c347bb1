// The connection to the server, and what its bytes mean: the other side of server/src/view/message.rs.

const MESH = 1, FRAME = 2, PICTURE = 3;
const STEP = 1, ENDED = 2, SUCCESS = 4;
const AGAIN_MS = 1500;

/** Keeps a connection to the server that served the page. `on` has a function for each kind of message. */
export class Link {
  #socket = null;
  #on;
  #ended = false;

  constructor(on) {
    this.#on = on;
    this.#open();
  }

  /** Sends a command where the server is there to take it. */
  send(command) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(command));
  }

  #open() {
    // Beside the page, wherever a tunnel or a proxy has put that.
    const address = new URL("live", document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.#text(JSON.parse(data));
      else this.#bytes(data);
    };
    socket.onclose = () => {
      this.#on.closed(this.#ended);
      setTimeout(() => this.#open(), AGAIN_MS);
    };
    this.#socket = socket;
  }

  #text(message) {
    if (message.type === "hello") this.#ended = false;
    if (message.type === "bye") this.#ended = true;
    this.#on[message.type]?.(message);
  }

  #bytes(buffer) {
    switch (new DataView(buffer).getUint32(0, true)) {
      case MESH: return this.#on.mesh(mesh(buffer));
      case FRAME: return this.#on.frame(frame(buffer));
      case PICTURE: return this.#on.picture(new Blob([new Uint8Array(buffer, 16)], { type: "image/png" }));
    }
  }
}

function mesh(buffer) {
  const [, number, vertices, triangles, colours] = new Uint32Array(buffer, 0, 5);
  return {
    number,
    positions: new Float32Array(buffer, 20, 3 * vertices),
    normals: new Float32Array(buffer, 20 + 12 * vertices, 3 * vertices),
    triangles: new Uint32Array(buffer, 20 + 24 * vertices, 3 * triangles),
    colours: colours > 0 ? new Float32Array(buffer, 20 + 24 * vertices + 12 * triangles, 3 * colours) : null,
  };
}

function frame(buffer) {
  const head = new Uint32Array(buffer, 0, 14);
  const [, scene, flags, steps, , , , , stage, parts, contacts, jaws, marks, skins] = head;
  const whole = (low) => (BigInt(head[low + 1]) << 32n) | BigInt(head[low]);
  let at = 56;
  const numbers = (count) => {
    const array = new Float32Array(buffer, at, count);
    at += 4 * count;
    return array;
  };
  const endoscope = numbers(8);
  const frame = {
    scene,
    steps,
    stage,
    seed: whole(4),
    episode: whole(6),
    endoscope: flags & 1 ? endoscope : null,
    poses: numbers(7 * parts),
    contacts: numbers(6 * contacts),
    jaws: numbers(4 * jaws),
    marks: [],
    skins: new Uint32Array(buffer, at + 8 * marks, skins),
  };
  const words = new DataView(buffer, at);
  for (let index = 0; index < marks; index++) {
    const flags = words.getUint32(8 * index + 4, true);
    frame.marks.push({
      reward: words.getFloat32(8 * index, true),
      isStep: (flags & STEP) !== 0,
      ended: (flags & ENDED) !== 0,
      success: (flags & SUCCESS) !== 0,
    });
  }
  return frame;
}
