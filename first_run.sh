#!/bin/sh
# viam-server runs this once for each version and waits for it for up to an hour. It always ends
# before that, because install.py has a limit, and it never fails: a failure here would hold up the
# whole machine, while run.sh goes on with the installation at the next start.
"$(dirname -- "$0")/setup.sh" || echo "the installation is tried again when the module starts" >&2
exit 0
