#include "watchdog.h"

#include <avr/io.h>
#include <avr/wdt.h>

static uint8_t reset_cause __attribute__((section(".noinit")));

// Runs before variables get their values. After a reset by the watchdog it is on, at its shortest time, and stays on as
// long as its flag is set.
__attribute__((naked, used, section(".init3"))) static void stop_watchdog(void)
{
    reset_cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

void watchdog_start(void)
{
    wdt_enable(WDTO_2S);
}

void watchdog_feed(void)
{
    wdt_reset();
}

uint8_t watchdog_reset_cause(void)
{
    return reset_cause;
}
