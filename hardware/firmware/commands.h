// What the host says, byte by byte: docs/frames.md, section "Commands". Portable C.
#ifndef COMMANDS_H
#define COMMANDS_H

#include <stdint.h>

typedef enum { COMMAND_NONE, COMMAND_INFO, COMMAND_RATE, COMMAND_ERRORS } command_t;

typedef struct {
    enum { BETWEEN, NUMBER, MALFORMED } state;
    uint8_t digits;    // seen of the number, up to 255
    uint16_t rate_hz;  // the number: valid when `commands_take` returns COMMAND_RATE; 65535 stands for more
} commands_t;

// The command that this byte completes. A zeroed `commands_t` waits for the first.
command_t commands_take(commands_t *commands, uint8_t byte);

#endif
