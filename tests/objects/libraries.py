"""Libraries and files for the tests of the object library."""

import contextlib
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from handsight.objects import Shape, ply_bytes
from objects.object_shapes import box_mesh

HALF_TURN = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def off_text(vertices, faces):
    rows = [" ".join(map(repr, row)) for row in np.asarray(vertices).tolist()]
    rows += [" ".join(map(str, [3, *face])) for face in np.asarray(faces).tolist()]
    return "\n".join([f"OFF\n{len(vertices)} {len(faces)} 0", *rows]) + "\n"


def block(folder, size=(0.06, 0.09, 0.14), name="block.off"):
    """A file of a box, in metres."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(off_text(*box_mesh(size)))
    return path


def bop(folder, sizes=((60, 90, 140), (50, 40, 30)), **changed):
    """A BOP folder as other tools write it, of boxes of these sizes [mm], with keys that handsight does not know."""
    infos = {}
    for k, size in enumerate(sizes):
        number = 4 * k + 1
        vertices, faces = box_mesh(size)
        (folder / "models").mkdir(parents=True, exist_ok=True)
        (folder / f"models/obj_{number:06d}.ply").write_bytes(ply_bytes(Shape(vertices, faces), 1.0))
        infos[str(number)] = {
            "diameter": float(np.linalg.norm(size)),
            "min_x": -size[0] / 2, "size_x": size[0], "size_y": size[1], "size_z": size[2],
            "symmetries_discrete": [HALF_TURN], "textured": True,
        }  # fmt: skip
    infos["1"] |= changed
    (folder / "models/models_info.json").write_text(json.dumps(infos))
    return folder


@contextlib.contextmanager
def served(folder, wrong=None):
    """A folder served over HTTP: its URL, and the list of requested paths. `wrong`: by the end of a path, the answer to
    give instead: a status, (bytes, announced length), the place to which it redirects, or a function that yields bytes."""
    asked, wrong = [], wrong or {}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            path = folder / self.path.lstrip("/")
            answer = next((value for end, value in wrong.items() if self.path.endswith(end)), None)
            if isinstance(answer, int) or (answer is None and not path.is_file()):
                self.send_error(answer or 404)
                return
            if isinstance(answer, str):
                self.send_response(302)
                self.send_header("Location", answer if answer.startswith("/") else answer + self.path)
                self.end_headers()
                return
            if callable(answer):
                self.send_response(200)
                self.end_headers()
                with contextlib.suppress(OSError):
                    for part in answer():
                        self.wfile.write(part)
                return
            data, length = answer or (path.read_bytes(), path.stat().st_size)
            self.send_response(200)
            self.send_header("Content-Length", str(length))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
