// SPDX-License-Identifier: GPL-3.0-or-later
// Runs the board's firmware, unchanged, on a simulated board: simavr's MCU, a table of readings, a pseudo terminal.

#include <elf.h>
#include <errno.h>
#include <math.h>
#include <signal.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>

#include "crossbar.h"
#include "options.h"
#include "port.h"
#include "table.h"
#include "uart.h"

#define FREQUENCY 16000000
#define TICK (FREQUENCY / 1000)  // cycles between two looks at the clock and the port

// registers in data memory, the same in both MCUs
#define MCUSR 0x54
#define EXTERNAL_RESET (1 << 1)
#define TIMSK1 0x6F

static volatile int is_stopped;
static volatile int is_reset_pressed;
static volatile int is_to_hang;
static bool is_tick;

static void on_signal(int number)
{
    if (number == SIGUSR1)
        is_reset_pressed = 1;
    else if (number == SIGUSR2)
        is_to_hang = 1;
    else
        is_stopped = 1;
}

static void catch_signals(void)
{
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGUSR1, &action, NULL);
    sigaction(SIGUSR2, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
}

static void log_errors(avr_t *avr, const int level, const char *format, va_list values)
{
    (void)avr;
    if (level == LOG_ERROR)
        vfprintf(stderr, format, values);  // standard output is for the two lines of JSON
}

// ---- firmware ---------------------------------------------------------------------------------------------

static void require_elf_for(const char *mcu, const char *path)
{
    Elf32_Ehdr header = {0};
    FILE *file = fopen(path, "rb");
    if (!file)
        fail("%s: %s: build the firmware first.", path, strerror(errno));
    size_t n_read = fread(&header, sizeof header, 1, file);
    fclose(file);
    if (n_read != 1 || memcmp(header.e_ident, ELFMAG, SELFMAG) != 0 || header.e_machine != EM_AVR)
        fail("%s: no AVR program in ELF form: give the .elf that the firmware's Makefile writes.", path);
    unsigned family = header.e_flags & 0x7F, expected = strcmp(mcu, "atmega2560") == 0 ? 6 : 5;
    if (family != expected)
        fail("%s: built for the family avr%u, but %s is of avr%u: choose another --elf or --mcu.", path, family, mcu,
             expected);
}

static void skip_sleep(avr_t *avr, avr_cycle_count_t cycles)
{
    (void)avr, (void)cycles;  // simavr puts the board's clock forward itself; the world's is waited for in `keep_pace`
}

static avr_t *board_with(const char *mcu, const char *path)
{
    if (strcmp(mcu, "atmega328p") != 0 && strcmp(mcu, "atmega2560") != 0)
        fail("--mcu %s is unknown, expected atmega328p or atmega2560.", mcu);
    require_elf_for(mcu, path);
    avr_global_logger_set(log_errors);
    elf_firmware_t firmware = {0};
    if (elf_read_firmware(path, &firmware) != 0)
        fail("%s: cannot be read as an ELF file: build the firmware again.", path);
    avr_t *avr = avr_make_mcu_by_name(mcu);
    if (!avr)
        fail("this simavr does not know %s: install a newer one.", mcu);
    avr_init(avr);
    avr->sleep = skip_sleep;
    if (firmware.flashsize > avr->flashend + 1)
        fail("%s: %u bytes, the flash of %s has %u.", path, firmware.flashsize, mcu, avr->flashend + 1);
    firmware.frequency = FREQUENCY;
    firmware.vcc = firmware.avcc = firmware.aref = CROSSBAR_AVCC_MV;
    avr_load_firmware(avr, &firmware);
    return avr;
}

// ---- time -------------------------------------------------------------------------------------------------

static avr_cycle_count_t on_tick(avr_t *avr, avr_cycle_count_t when, void *unused)
{
    (void)avr, (void)unused;
    is_tick = true;
    return when + TICK;
}

// Called by avr_reset, the button's or the watchdog's, which forgets all timers.
static void on_reset(avr_t *avr)
{
    crossbar_reset(avr);
    uart_reset();
    avr_cycle_timer_register(avr, TICK, on_tick, NULL);
}

static double seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

// Sleep until the world's clock has caught up with the board's; returns how far the board was behind.
static double keep_pace(double due)
{
    double ahead = due - seconds_now();
    if (ahead <= 0)
        return -ahead;
    struct timespec rest = {.tv_sec = (time_t)ahead, .tv_nsec = (long)(fmod(ahead, 1.0) * 1e9)};
    nanosleep(&rest, NULL);
    return 0;
}

// Until stopped; returns the largest lag behind real time, 0 if it does not matter.
static double run(avr_t *avr, const options_t *options)
{
    double start = seconds_now(), max_lag = 0;
    while (!is_stopped) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed)
            fail("%s: the program crashed or went to sleep for good at 0x%x.", options->elf, avr->pc);
        if (!is_tick)
            continue;
        is_tick = false;
        uart_flush(options->fast, &is_stopped);
        uart_listen();
        double board_seconds = (double)avr->cycle / FREQUENCY;
        if (options->seconds > 0 && board_seconds >= options->seconds)
            break;
        if (!options->fast)
            max_lag = fmax(max_lag, keep_pace(start + board_seconds));
        if (is_reset_pressed) {
            is_reset_pressed = 0;
            avr_reset(avr);
            avr->data[MCUSR] = EXTERNAL_RESET;
        }
        if (is_to_hang) {
            is_to_hang = 0;
            avr->data[TIMSK1] = 0;
        }
    }
    uart_flush(options->fast, &is_stopped);
    return max_lag;
}

// ---- reports ----------------------------------------------------------------------------------------------

static void report_start(const options_t *options)
{
    printf("{\"port\": \"%s\", \"mcu\": \"%s\"}\n", port_name(), options->mcu);
    fflush(stdout);
}

static void report_end(const avr_t *avr, double max_lag)
{
    const crossbar_statistics_t *crossbar = crossbar_statistics();
    const uart_statistics_t *uart = uart_statistics();
    printf("{\"seconds\": %.6f, \"cycles\": %llu", (double)avr->cycle / FREQUENCY, (unsigned long long)avr->cycle);
    printf(", \"bytes_sent\": %llu, \"bytes_dropped\": %llu, \"bytes_received\": %llu, \"bytes_overrun\": %llu",
           (unsigned long long)uart->sent, (unsigned long long)uart->dropped, (unsigned long long)uart->received,
           (unsigned long long)uart->overrun);
    printf(", \"conversions\": %llu, \"min_settle_us\": ", (unsigned long long)crossbar->conversions);
    if (crossbar->conversions > 0)
        printf("%.2f", (double)crossbar->min_settle * 1e6 / FREQUENCY);
    else
        printf("null");
    printf(", \"bad_addresses\": %llu, \"max_lag_ms\": %.3f}\n", (unsigned long long)crossbar->bad_addresses,
           1e3 * max_lag);
    fflush(stdout);
}

int main(int argc, char **argv)
{
    options_t options = options_parse(argc, argv);
    catch_signals();
    if (options.with_parent)
        prctl(PR_SET_PDEATHSIG, SIGTERM);
    table_t table = table_open(options.table);
    avr_t *avr = board_with(options.mcu, options.elf);
    crossbar_connect(avr, options.mcu, &table);
    uart_connect(avr, options.damage);
    port_open();
    avr->reset = on_reset;
    on_reset(avr);
    report_start(&options);
    double max_lag = run(avr, &options);
    if (options.fast)
        port_drain(&is_stopped);
    report_end(avr, max_lag);
    return 0;
}
