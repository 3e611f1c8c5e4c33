#!/bin/sh
# A stand-in for the program gphoto2 with a camera on the cable. Its camera is the folder $FAKE_GPHOTO2: what each setting
# can be (choices) and is (now), DNG files of all settings (frames), how many were taken (count), how captures end (bad).
# Like the real program (2.5.28, seen with a folder as its camera) it does what the options say in their order, goes on
# after one that failed, and ends with the exit code of the last one. The clock begins ten minutes before midnight.
camera=$FAKE_GPHOTO2
printf '%s\n' "$*" >>"$camera/calls"
for name in "$@"; do :; done # the file's name comes last
code=0
while [ $# -gt 0 ]; do
  case $1 in
  --get-config)
    printf 'Label: %s\nReadonly: 0\nType: RADIO\n' "$2"
    awk '{print "Choice: " NR - 1 " " $0} END {print "END"}' "$camera/choices/$2"
    shift
    ;;
  --set-config-value)
    code=1
    if grep -qxF -- "${2#*=}" "$camera/choices/${2%%=*}"; then
      code=0
      printf '%s' "${2#*=}" >"$camera/now/${2%%=*}"
    fi
    shift
    ;;
  --capture-image-and-download | --wait-event-and-download=*)
    if [ "$(cat "$camera/bad")" = fails ]; then
      code=1
    elif [ "$(cat "$camera/bad")" != nothing ]; then
      count=$(($(cat "$camera/count") + 1))
      echo $count >"$camera/count"
      taken=$(date -u -d "@$((1795305000 + 3 * count))" '+%Y:%m:%d %H:%M:%S')
      frame=$(cat "$camera/now/iso")_$(tr / - <"$camera/now/shutterspeed").dng
      LC_ALL=C sed "s/2000:01:01 00:00:00/$taken/g" "$camera/frames/$frame" >"${name%.%C}.dng"
      code=$?
    fi
    ;;
  esac
  shift
done
exit $code
