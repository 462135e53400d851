// SPDX-License-Identifier: GPL-3.0-or-later
// What was asked for on the command line, and how to refuse it.
#ifndef OPTIONS_H
#define OPTIONS_H

#include <stdbool.h>

typedef struct {
    const char *elf;
    const char *mcu;
    const char *table;
    double seconds;    // of device time; 0: until stopped
    bool fast;
    bool with_parent;
    unsigned long damage;  // every so manieth byte to the board has a wrong stop bit; 0: none
} options_t;

options_t options_parse(int argc, char **argv);

// One line on stderr, then exit code 2.
_Noreturn void fail(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
