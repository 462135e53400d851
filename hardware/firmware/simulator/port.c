// SPDX-License-Identifier: GPL-3.0-or-later
#define _GNU_SOURCE
#include "port.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "options.h"

static int master, slave;
static char name[128];
static const char *link_path;

static void remove_link(void)
{
    char target[sizeof name] = "";
    ssize_t length = readlink(link_path, target, sizeof target - 1);
    if (length > 0 && strcmp(target, name) == 0)  // another board may have taken it over
        unlink(link_path);
}

static void make_link(void)
{
    struct stat status;
    if (lstat(link_path, &status) == 0 && !S_ISLNK(status.st_mode))
        fail("%s: exists and is no link: choose another --link, or remove it.", link_path);
    char temporary[PATH_MAX];
    snprintf(temporary, sizeof temporary, "%s.%ld", link_path, (long)getpid());
    if (symlink(name, temporary) < 0 || rename(temporary, link_path) < 0)  // a rename replaces an old link at once
        fail("%s: %s: choose another --link.", link_path, strerror(errno));
    atexit(remove_link);
}

void port_open(const char *link)
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
    link_path = link;
    if (link)
        make_link();
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
