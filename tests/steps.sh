# Sourced by .ci/run and tests/run: steps that are timed, and a table of what each took.
# Wall time belongs to the machine and to who else is on it; CPU seconds, of a step and of all that it starts, are what a
# change costs.

steps_table=""

# step NAME COMMAND...: runs the command with no input, and notes how long it took. Its status is the command's.
step() {
    local name="$1" status=0 clock seconds TIMEFORMAT='%R %U %S'
    shift
    echo "== $name"
    clock=$(mktemp)
    # The shell's own clock writes to what is the standard error out here; the command keeps the one that it had.
    { time "$@" 2>&3 </dev/null; } 3>&2 2>"$clock" || status=$?
    seconds=$(tail -n 1 "$clock")
    rm -f "$clock"
    steps_table+="$seconds $status $name"$'\n'
    return "$status"
}

# print_steps TITLE: what each step took.
print_steps() {
    echo "== $1"
    printf '%s' "$steps_table" | awk '
        BEGIN { printf "%9s %9s  %s\n", "wall s", "CPU s", "step" }
        {
            cpu = $2 + $3
            name = $5
            for (i = 6; i <= NF; i++) name = name " " $i
            printf "%9.1f %9.1f  %s%s\n", $1, cpu, name, ($4 == 0 ? "" : " (FAILED)")
            wall_all += $1
            cpu_all += cpu
        }
        END { printf "%9.1f %9.1f  %s\n", wall_all, cpu_all, "in all" }'
}
