# SPDX-License-Identifier: MIT
#
# Holds the kernel's readings against those of gaugefs. Files: differences, gaugefs, kernel; variables:
# driver, and `used`, a file that collects the differences that showed.

FNR == 1 { file++ }
/^#/ || NF == 0 { next }

file == 1 {
    if (driver ~ "^(" $1 ")$") how[$2] = $3
    next
}

{
    name = $1
    value = substr($0, length(name) + 2)
}

file == 2 { ours[name] = value }

file == 3 {
    plain = name
    prefix = ""
    if (sub(/^uevent:/, "", plain)) {
        plain = tolower(plain)
        prefix = "uevent:"
    }
    row = name in how ? name : plain in how ? plain : ""
    mine = name in ours ? ours[name] : "-"
    if (row != "" && mine != value) print row >>used
    if (row != "" && (how[row] == "differs" || how[row] == "if:" value || how[row] == "none" && mine == "-")) next
    if (row != "" && how[row] ~ /^is:/) {
        other = substr(how[row], 4)
        if (prefix != "") other = prefix toupper(other)
        mine = other in ours ? ours[other] : "-"
    }
    compared++
    if (mine != value) {
        print name ": kernel " value ", gaugefs " mine
        wrong = 1
    }
}

END {
    if (compared < 10) print "only " compared + 0 " values compared"
    exit wrong || compared < 10
}
