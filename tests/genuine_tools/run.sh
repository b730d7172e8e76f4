#!/bin/sh
# Loads the robot description with other programs, and reads mesh and cloud files that other programs
# write: environments of pinned packages (6 GB). OpenSCAD and PCL's tools take part where installed.
set -eu
cd "$(dirname "$0")/../.."
OURS=$PWD/.venv/bin/python
HERE=tests/genuine_tools
FOLDER=${TOOLS_FOLDER:-.venv-tools}
env_of() { # name, Python, packages
    name=$FOLDER/$1 python=$2
    shift 2
    [ -x "$name/bin/python" ] || "$python" -m venv "$name"
    "$name/bin/python" -m pip install -q "$@"
}
PY=${TOOLS_PYTHON:-python3.12}
env_of urdf "$PY" ikpy==4.2.1 drake==1.51.1 mujoco==4.0.0 yourdfpy==0.0.60 urchin==0.0.30 pin==4.1.0
"$FOLDER/urdf/bin/python" -W ignore $HERE/urdf_in_tools.py urdf/so101.urdf

env_of blender "${BLENDER_PYTHON:-python3.11}" bpy==5.0.1
env_of libraries "$PY" meshio==5.3.5 vtk==9.7.2 pymeshlab==2025.7.post1 trimesh==5.2.0
env_of cadquery "$PY" cadquery==2.8.0
env_of build123d "$PY" build123d==0.13.0
env_of open3d "$PY" open3d==0.20.0
FILES=$(mktemp -d)
trap 'rm -rf "$FILES"' EXIT
MAKE=$HERE/make_files
"$FOLDER/libraries/bin/python" $MAKE/mesh_libraries.py "$FILES"
"$FOLDER/blender/bin/python" $MAKE/blender_files.py "$FILES" 1 >/dev/null
"$FOLDER/blender/bin/python" $MAKE/blender_files.py "$FILES" 0.001 >/dev/null
"$FOLDER/cadquery/bin/python" $MAKE/cad_files.py "$FILES" cq
"$FOLDER/build123d/bin/python" $MAKE/cad_files.py "$FILES" b
"$FOLDER/open3d/bin/python" $MAKE/open3d_files.py "$FILES"
if command -v openscad >/dev/null; then
    for kind in stl off 3mf; do openscad -q -o "$FILES/openscad.$kind" $MAKE/part.scad; done
fi
if command -v pcl_convert_pcd_ascii_binary >/dev/null; then
    for form in 0 1 2; do
        pcl_convert_pcd_ascii_binary "$FILES/o3d.pcd" "$FILES/pcl_$form.pcd" $form >/dev/null 2>&1
    done
fi
rm -f "$FILES"/*.mtl
"$OURS" $HERE/check_files.py "$FILES" benchmarks/results/mesh_files.json
