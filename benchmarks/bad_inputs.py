"""What bad input gets: `python benchmarks/bad_inputs.py [--checkout DIR] [PART OF A COMMAND]`.

Runs every command of `bad_inputs.txt` in a folder of bad files and prints a Markdown table: the one sentence a refusal
should be, `accepted`, `traceback`, or what else came of it. Another checkout gives the column to compare with.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
QUIET = ("tracking=none",)
SETTINGS = {
    "optimise": (*QUIET, "budget.evaluations=20", "validate=false"),
    "evaluate": (*QUIET, "validate=false", "localisation=false"),
    "export": QUIET,
    "report": (),
}
SECONDS = 100.0

HEADER = "id,x,y,z,nx,ny,nz\n"
GOOD = f"{HEADER}7,0,1,1,1,0,0\n3,0,2,1,1,0,0\n9,7.5,2,1,-1,0,0\n"
TURNS = [(i, (37 * i) % 360) for i in range(600)]
EVERY_BYTE = bytes(range(256)) * 40
BOX = "".join(f"v {x} {y} {z}\n" for z in (0, 3) for y in (0, 5) for x in (0, 6))
BOX += "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 1 3 7 5\nf 2 4 8 6\n"
MESHES = '"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "asset": {"version": "2.0"}, '
MESHES += '"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], '
CORNERS = '"componentType": 5126, "type": "VEC3", "count"'
FILES: dict[str, str | bytes | None] = {  # None for a pipe into which nobody writes
    "good.csv": GOOD,
    "dup.csv": f"{HEADER}1,0,1,1,1,0,0\n1,0,2,1,1,0,0\n2,0,3,1,1,0,0\n",
    "comment.csv": f"# tags of the lab\n{GOOD}# end\n",
    "note.csv": "id,x,y,z,nx,ny,nz,note\n7,0,1,1,1,0,0,by the door\n3,0,2,1,1,0,0,\n9,7.5,2,1,-1,0,0,shelf\n",
    "degrees_pdf.csv": "yaw,pitch,weight\n0,0,0.5\n180,0,0.5\n",
    "comment_pdf.csv": "# yaw\nyaw,pitch,weight\n0,0,0.5 # ahead\n3.14,0,0.5\n",
    "degrees_rec.csv": "time,yaw,pitch\n" + "".join(f"{i},{yaw},0\n" for i, yaw in TURNS[:60]),
    "comment_rec.csv": "# flight\ntime,yaw,pitch\n" + "".join(f"{i},{yaw / 60},{i % 11 / 50}\n" for i, yaw in TURNS),
    "empty.csv": "",
    "header.csv": HEADER,
    "wrong.csv": "a,b,c\n1,2,3\n",
    "blank.csv": "\n\n\n",
    "onlycomments.csv": "# a\n# b\n",
    "idtext.csv": f"{HEADER}a,0,1,1,1,0,0\nb,0,2,1,1,0,0\n",
    "idneg.csv": f"{HEADER}-1,0,1,1,1,0,0\n2,0,2,1,1,0,0\n",
    "idfloat.csv": f"{HEADER}1.5,0,1,1,1,0,0\n2,0,2,1,1,0,0\n",
    "dupcol.csv": "id,x,x,y,z,nx,ny,nz\n0,0,0,1,1,1,0,0\n1,0,0,2,1,1,0,0\n",
    "semicolon.csv": GOOD.replace(",", ";"),
    "huge.csv": f"{HEADER}0,1e300,1,1,1,0,0\n1,0,2,1,1,0,0\n",
    "utf16.csv": GOOD.encode("utf-16"),
    "binary.csv": EVERY_BYTE,
    "bom.csv": b"\xef\xbb\xbf" + GOOD.encode(),
    "nul.csv": GOOD.encode().replace(b"1,1,1", b"1,\x00,1"),
    "quote.csv": f'{HEADER}0,"0,1,1,1,0,0\n',
    "time_back.csv": "time,yaw,pitch\n0,0,0\n1,0,0\n0.5,0,0\n",
    "one_rec.csv": "time,yaw,pitch\n0,0,0\n",
    "const_rec.csv": "time,yaw,pitch\n" + "".join(f"{i},0,0\n" for i in range(50)),
    "camera.yaml": "image_width: 640\nimage_height: 480\n",
    "fisheye.yaml": "cam0: {camera_model: pinhole, distortion_model: equidistant}\n",
    "badlimits.yaml": "a: [\n",
    "limits.yaml": "pitch: x\n",
    "traj.csv": "time,x,y,z,yaw,pitch\n0,3,2,3,0,0\n1,3.1,2,3,90,0\n",
    "traj_far.csv": "time,x,y,z,yaw,pitch\n0,30,2,3,0,0\n1,30.1,2,3,0.1,0\n",
    "junkimages/a.png": "nope",
    "adir/unrelated": "",
    "brokenrun/.hydra/config.yaml": "a: [\n",
    "brokenrun/landmarks.csv": GOOD,
    "binaryrun/.hydra/config.yaml": EVERY_BYTE,
    "binaryrun/landmarks.csv": GOOD,
    "binrun/checkpoint.npz": EVERY_BYTE,
    "oldrun/checkpoint.pkl": EVERY_BYTE,
    "stranger/pipe.csv": None,
    "stranger/bomb.yaml": "a0: &a0 [1, 1]\n"
    + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 30))
    + "camera_matrix: {data: *a29}\n",
    "stranger/zeros.gltf": f'{{{MESHES}"accessors": [{{{CORNERS}: 600000000}}], "bufferViews": []}}',
    "stranger/outside.gltf": f'{{{MESHES}"buffers": [{{"uri": "../../corners.bin", "byteLength": 36}}]}}',
    "stranger/corner.obj": BOX.replace("v 6 5 3", "v 6 inf 3"),
    "stranger/box.obj": BOX,
    "stranger/lying.obj": BOX.replace("5 3", "5 9").replace("0 3", "0 9"),
}


def outcome(command: str, checkout: Path) -> str:
    """Outcome of one command in a fresh folder with the files."""
    pipeline, *overrides = shlex.split(command)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in FILES.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            if content is None:
                os.mkfifo(folder / file)
                continue
            (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())
        line = [sys.executable, "-m", f"pipelines.{pipeline}", *SETTINGS.get(pipeline, QUIET), *overrides]
        environment = os.environ | {"PYTHONPATH": str(checkout)}
        before = set(folder.rglob("*"))
        try:
            done = subprocess.run(
                line, cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            return f"over {SECONDS:.0f} s"
        left = [path for path in set(folder.rglob("*")) - before if path.is_file()]
        return described(done, left)


def described(done: "subprocess.CompletedProcess[str]", left: list[Path]) -> str:
    """An outcome in a few words."""
    lines = done.stderr.strip().splitlines()
    if done.returncode == 0:
        return "accepted"
    if "Traceback" in done.stderr:
        return f"traceback ({len(lines)} lines)"
    files = f" (leaves {', '.join(sorted(path.name for path in left))})" if left else ""
    if len(lines) == 1 and lines[0].startswith("error: "):
        return lines[0].removeprefix("error: ") + files
    return f"{len(lines)} lines: {lines[0] if lines else ''}{files}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkout", type=Path, default=HERE.parent)
    parser.add_argument("part", nargs="?", default="")
    arguments = parser.parse_args()
    print("| input | outcome |\n| --- | --- |")
    for command in (HERE / "bad_inputs.txt").read_text().splitlines():
        if arguments.part in command:
            print(f"| `{command}` | {outcome(command, arguments.checkout.resolve()).replace('|', '/')} |", flush=True)


if __name__ == "__main__":
    main()
