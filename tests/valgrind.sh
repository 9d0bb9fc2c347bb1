#!/bin/sh
# The program $TROCAR_UNDER_VALGRIND under valgrind: `make test-valgrind` names this script to the
# tests as the program `trocar`. Where valgrind finds an error, it says so and kills the program, so
# that the test which uses it fails.
exec valgrind --quiet --error-exitcode=9 --exit-on-first-error=yes --fair-sched=yes \
	"$TROCAR_UNDER_VALGRIND" "$@"
