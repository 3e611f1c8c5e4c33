#
# First set the camera to M, manual focus, ISO automatics off, raw alone (with a JPEG beside it some cameras hand over the
# raw of the shot before), single drive, long-exposure noise reduction off, USB mode "PC remote" or PTP. Then look:
#   gphoto2 --auto-detect                                     whether the camera is found
#   gphoto2 --get-config iso --get-config shutterspeed        what it calls its ISOs and times
# Where it calls a setting or a choice otherwise than this script (Nikon's exact times are shutterspeed2), replace it here.
#
# Frames go into folders beside this script. A frame that is there is skipped: run the script again if it was cut off, and
# delete a frame to take it again. `capture manifest` reads from the files' EXIF whether each is as planned.
set -eu
export LC_ALL=C
CDPATH='' cd -- "$(dirname -- "$0")"

stop() {
  printf '%s\n' "$1" >&2
  exit 1
}

# offers SETTING CHOICE...
offers() {
  setting=$1
  shift
  choices=$(gphoto2 --get-config "$setting")
  for choice in "$@"; do
    printf '%s\n' "$choices" | grep -q "^Choice: [0-9]* $choice *\$" ||
      stop "the camera's $setting has no $choice: see gphoto2 --get-config $setting, its mode dial, and the top of $0"
  done
}

# prepare TEXT: to be shown before the next frame that is taken
prepare() {
  todo=$1
}

there() {
  for file in "$1".*; do
    if [ -e "$file" ]; then return; fi
  done
  return 1
}

# shot FILE ISO TIME [SECONDS]; the seconds are those of a bulb exposure
shot() {
  if there "$1"; then return; fi
  if [ -n "$todo" ]; then
    printf '\n%s\n    Enter when ready, Ctrl-C to stop: ' "$todo"
    read -r enter || stop 'nobody can press Enter here: run this script in a terminal'
    todo=
  fi
  mkdir -p "${1%/*}"
  # A call each: gphoto2 goes on after an option that failed, and its exit code is that of the last one.
  gphoto2 --set-config-value iso="$2"
  gphoto2 --set-config-value shutterspeed="$3"
  if [ $# = 3 ]; then
    gphoto2 --capture-image-and-download --filename "$1.%C"
  else
    gphoto2 --set-config bulb=1 --wait-event="$4s" --set-config bulb=0 \
      --wait-event-and-download=10s --filename "$1.%C"
  fi
  there "$1" || stop "gphoto2 ended well, and there is no $1: look at the camera"
}
