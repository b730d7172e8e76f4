/* Reads a serial port, for drivers/port/serial_port.py; Windows has no such ports. */
#ifndef _WIN32
#include <errno.h>
#include <poll.h>
#include <unistd.h>

/* Wait at most `wait` [ms] for bytes and read at most `size`. Returns how many came, or -errno: -EPIPE after a
 * hang-up or at an end of file. */
int so101_serial_read(int fd, char *bytes, int size, int wait) {
    struct pollfd port = {.fd = fd, .events = POLLIN};
    int ready;
    ssize_t came;
    do ready = poll(&port, 1, wait);
    while (ready < 0 && errno == EINTR);
    if (ready < 0) return -errno;
    if (ready == 0) return 0;
    if (!(port.revents & POLLIN)) return -EPIPE;
    do came = read(fd, bytes, size);
    while (came < 0 && errno == EINTR);
    return came > 0 ? (int)came : came < 0 ? -errno : -EPIPE;
}
#endif
