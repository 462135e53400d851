// SPDX-License-Identifier: GPL-3.0-or-later
#include "options.h"

#include <getopt.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

static const char USAGE[] =
    "usage: simavr-board --elf FILE --mcu atmega328p|atmega2560 --table FILE [--seconds S] [--fast]\n"
    "                   [--with-parent] [--damage N]\n"
    "\n"
    "Runs the firmware in FILE on a simulated board. Its serial port is a pseudo terminal, named on the first\n"
    "line of output; the readings of its converter come from the table.\n"
    "  --seconds S  stop after S seconds of the board's time\n"
    "  --fast       as fast as possible instead of in real time; waits for a reader, so that nothing is lost\n"
    "  --with-parent  stop when the program that started this one is gone, however it ended\n"
    "  --damage N   every Nth byte to the board arrives with a wrong stop bit\n"
    "SIGINT or SIGTERM stops it and prints statistics, SIGUSR1 presses the board's reset button, SIGUSR2 takes the\n"
    "interrupt away that starts scans: a board that hangs.\n";

void fail(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    fputs("simavr-board: ", stderr);
    vfprintf(stderr, format, values);
    fputc('\n', stderr);
    va_end(values);
    exit(2);
}

static double seconds_from(const char *text)
{
    char *end;
    double seconds = strtod(text, &end);
    if (end == text || *end || !isfinite(seconds) || seconds <= 0)
        fail("--seconds is '%s', expected a number above 0.", text);
    return seconds;
}

static unsigned long number_from(const char *text)
{
    char *end;
    unsigned long number = strtoul(text, &end, 10);
    if (*text < '1' || *text > '9' || *end)
        fail("--damage is '%s', expected a whole number above 0.", text);
    return number;
}

options_t options_parse(int argc, char **argv)
{
    static const struct option LONG[] = {
        {"elf", required_argument, NULL, 'e'},     {"mcu", required_argument, NULL, 'm'},
        {"table", required_argument, NULL, 't'},   {"seconds", required_argument, NULL, 's'},
        {"fast", no_argument, NULL, 'f'},          {"help", no_argument, NULL, 'h'},
        {"with-parent", no_argument, NULL, 'p'},   {"damage", required_argument, NULL, 'd'},
        {NULL, 0, NULL, 0},
    };
    options_t options = {0};
    opterr = 0;
    for (int option; (option = getopt_long(argc, argv, ":", LONG, NULL)) != -1;) {
        switch (option) {
        case 'e': options.elf = optarg; break;
        case 'm': options.mcu = optarg; break;
        case 't': options.table = optarg; break;
        case 's': options.seconds = seconds_from(optarg); break;
        case 'f': options.fast = true; break;
        case 'p': options.with_parent = true; break;
        case 'd': options.damage = number_from(optarg); break;
        case 'h': fputs(USAGE, stdout); exit(0);
        case ':': fail("%s needs a value: see --help.", argv[optind - 1]);
        default: fail("unknown option '%s': see --help.", argv[optind - 1]);
        }
    }
    if (optind < argc)
        fail("'%s' belongs to no option: see --help.", argv[optind]);
    if (!options.elf || !options.mcu || !options.table)
        fail("%s is missing: see --help.", !options.elf ? "--elf" : !options.mcu ? "--mcu" : "--table");
    return options;
}
