#!/bin/sh
# viam-server runs this once for each version, with time enough to install. It never fails: a
# failure here would hold up the whole machine, and run.sh tries again at every start.
"$(dirname -- "$0")/run.sh" --install || echo "the installation will be tried again at the start" >&2
exit 0
