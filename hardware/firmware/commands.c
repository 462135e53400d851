#include "commands.h"

static void add_digit(commands_t *commands, uint8_t digit)
{
    commands->rate_hz = commands->rate_hz > (65535 - digit) / 10 ? 65535 : commands->rate_hz * 10 + digit;
    if (commands->digits < 255)
        commands->digits++;
}

command_t commands_take(commands_t *commands, uint8_t byte)
{
    if (byte == '?' || byte == '!') {  // always heard, even where a host went away in the middle of a command
        commands->state = BETWEEN;
        return byte == '?' ? COMMAND_INFO : COMMAND_ERRORS;
    }
    if (byte == '\n') {
        uint8_t is_whole = commands->state == NUMBER && commands->digits > 0;
        commands->state = BETWEEN;
        return is_whole ? COMMAND_RATE : COMMAND_NONE;
    }
    if (commands->state == BETWEEN && byte == 'R') {
        *commands = (commands_t){.state = NUMBER};
    } else if (commands->state == NUMBER) {
        if (byte >= '0' && byte <= '9')
            add_digit(commands, byte - '0');
        else
            commands->state = MALFORMED;
    }
    return COMMAND_NONE;
}
