// SPDX-License-Identifier: GPL-3.0-or-later
#define _GNU_SOURCE
#include "port.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pty.h>
#include <string.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "options.h"

static int master, slave;
static char name[128];

void port_open(void)
{
    struct termios raw;
    if (openpty(&master, &slave, name, NULL, NULL) < 0 || tcgetattr(slave, &raw) < 0)
        fail("no pseudo terminal: %s.", strerror(errno));
    cfmakeraw(&raw);  // no echo, no line editing, no signals: a wire
    tcsetattr(slave, TCSANOW, &raw);
    // The slave's end stays open here: else reading the master fails (EIO) whenever no host has it open.
    fcntl(master, F_SETFL, O_NONBLOCK);
    fcntl(master, F_SETFD, FD_CLOEXEC);
    fcntl(slave, F_SETFD, FD_CLOEXEC);
}

const char *port_name(void)
{
    return name;
}

size_t port_write(const uint8_t *bytes, size_t size)
{
    ssize_t written = write(master, bytes, size);
    return written > 0 ? (size_t)written : 0;
}

void port_wait_for_room(int timeout_ms)
{
    struct pollfd room = {.fd = master, .events = POLLOUT};
    poll(&room, 1, timeout_ms);
}

size_t port_read(uint8_t *bytes, size_t size)
{
    ssize_t received = read(master, bytes, size);
    return received > 0 ? (size_t)received : 0;
}

void port_drain(const volatile int *stop)
{
    const struct timespec millisecond = {.tv_nsec = 1000000};
    int before = INT_MAX;
    for (int idle_ms = 0, empty_ms = 0; idle_ms < 1000 && empty_ms < 5 && !*stop; idle_ms++) {
        int waiting = 0;
        ioctl(slave, FIONREAD, &waiting);
        empty_ms = waiting == 0 ? empty_ms + 1 : 0;  // for some time: bytes pass through more than one queue
        if (waiting != before)
            idle_ms = 0;
        before = waiting;
        nanosleep(&millisecond, NULL);
    }
}
