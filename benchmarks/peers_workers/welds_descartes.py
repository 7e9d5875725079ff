# mypy: disable-error-code="import-not-found,import-untyped"
"""Descartes on poses of an arm with a torch: joints at each, with the roll about the torch's axis in steps or fixed.

Run by `welds.py descartes` with an interpreter that has tesseract-robotics. Reads from standard input the URDF, base
and tip of its arm, and the curves, lists of flat poses, each with the posture where a numerical search begins; writes a
line of JSON for each: joints, seconds, or the reason why not.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tesseract_robotics
from shifted import shifted
from tesseract_robotics import tesseract_command_language as language
from tesseract_robotics import tesseract_common as common
from tesseract_robotics import tesseract_environment as environment
from tesseract_robotics import tesseract_motion_planners as planners
from tesseract_robotics import tesseract_motion_planners_descartes as descartes

LIBRARIES = Path(tesseract_robotics.__file__).parent.parent / "tesseract_robotics.libs"
SRDF = """<?xml version="1.0"?><robot name="{name}" version="1.0.0">
<group name="arm"><chain base_link="{base}" tip_link="{tip}"/></group>
<kinematics_plugin_config filename="file://{folder}/kinematics.yaml"/>
</robot>"""
PLUGINS = """kinematic_plugins:
  search_paths: [{libraries}]
  search_libraries: [{names}]
  fwd_kin_plugins:
    arm:
      default: Forward
      plugins:
        Forward: {{class: KDLFwdKinChainFactory, config: {{base_link: {base}, tip_link: {tip}}}}}
  inv_kin_plugins:
    arm:
      default: Inverse
      plugins:
        Inverse: {{class: {inverse}, config: {{base_link: {base}, tip_link: {tip}{more}}}}}
"""
#: Kinds of inverse kinematics: closed forms of the UR arms, and a numerical search for any other.
KDL, CLOSED = "KDLInvKinChainLMAFactory", "URInvKinFactory"


def libraries(*words: str) -> dict[str, object]:
    """Folder and names of the libraries that have plugins."""
    names = [path.stem[3:] for word in words for path in LIBRARIES.glob(f"*{word}*")]
    return {"libraries": LIBRARIES, "names": ", ".join(names)}


def world_of(urdf: str, folder: str, base: str, tip: str, inverse: str, model: str = "") -> environment.Environment:
    """A robot's environment, with inverse kinematics of a kind from base to tip."""
    urdf = re.sub(r"<(visual|collision|transmission|gazebo)\b.*?</\1>", "", urdf, flags=re.S)
    match = re.search(r'<robot[^>]*name="(.*?)"', urdf)
    assert match
    more = f", model: {model}" if model else ""
    found = libraries("kinematics_kdl_factories", "kinematics_ur_factory")
    kinematics = PLUGINS.format(**found, base=base, tip=tip, inverse=inverse, more=more)
    (Path(folder) / "kinematics.yaml").write_text(kinematics)
    world = environment.Environment()
    srdf = SRDF.format(name=match[1], folder=folder, base=base, tip=tip)
    assert world.init(urdf, srdf, common.GeneralResourceLocator())
    return world


def main() -> None:
    given = json.load(sys.stdin)
    step, ends = given["step"], (given["base"], given["tip"])
    for curve in given["curves"]:
        with tempfile.TemporaryDirectory() as folder:
            zero = np.zeros(len(given["joints"]))
            if given["model"]:
                world = world_of(given["urdf"], folder, *ends, CLOSED, given["model"])
            else:
                zero = np.array(curve["zero"])
                moved = shifted(given["urdf"], dict(zip(given["joints"], curve["zero"], strict=True)))
                world = world_of(moved, folder, *ends, KDL)
            found = solved(world, curve["poses"], step, base=given["base"])
            if "q" in found:
                found["q"] = (np.array(found["q"]) + zero).tolist()
            print(json.dumps(found), flush=True)


def solved(
    world: environment.Environment,
    poses: list[list[float]],
    step: float | None,
    tip: str = "torch",
    base: str = "base_link",
) -> dict[str, object]:
    """Joints at poses; the roll is free in steps of so much, or fixed."""
    arm = common.ManipulatorInfo()
    arm.manipulator, arm.tcp_frame, arm.working_frame = "arm", tip, base
    program = language.CompositeInstruction("WELD")
    program.setManipulatorInfo(arm)
    for z in poses:
        pose = np.eye(4)
        pose[:3, 3], pose[:3, :3] = z[:3], np.reshape(z[3:], (3, 3))
        point = language.CartesianWaypoint(common.Isometry3d(pose))
        move = language.MoveInstruction(
            language.CartesianWaypointPoly_wrap_CartesianWaypoint(point), language.MoveInstructionType_LINEAR, "WELD"
        )
        program.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
    profile = descartes.DescartesDefaultPlanProfileD()
    profile.enable_collision = profile.enable_edge_collision = False
    profile.allow_collision = True
    profile.target_pose_fixed = step is None
    if step is not None:
        profile.target_pose_sample_axis = np.array([0.0, 0.0, 1.0])
        profile.target_pose_sample_resolution = step
        profile.target_pose_sample_min, profile.target_pose_sample_max = -np.pi, np.pi - step
    profile.use_redundant_joint_solutions = False
    profiles = language.ProfileDictionary()
    profiles.addProfile("Descartes", "WELD", descartes.cast_DescartesPlanProfileD(profile))
    request = planners.PlannerRequest()
    request.env, request.instructions, request.profiles = world, program, profiles
    began = time.process_time()
    found = descartes.DescartesMotionPlannerD("Descartes").solve(request)
    seconds = time.process_time() - began
    if not found.successful:
        return {"message": found.message, "seconds": seconds}
    q = []
    for instruction in found.results.flatten():
        # Its way point lives as long as the instruction is held.
        move = language.InstructionPoly_as_MoveInstructionPoly(instruction)
        point = move.getWaypoint()
        q.append(np.ravel(language.WaypointPoly_as_StateWaypointPoly(point).getPosition()).tolist())
    return {"q": q, "seconds": seconds}


if __name__ == "__main__":
    main()
