#include "link.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

/* Records of the hub, little-endian (tunefree_hil/bus/tfhub/records.py): u16 length, u8 type, u8 sender, u64 sequence,
 * u64 time in ns; a FRAME goes on with the 16 bytes of struct can_frame, the others with JSON. */
enum { HEAD = 20, RECORD = 36, FRAME = 1, HELLO = 2, WELCOME = 3, REFUSED = 4, BYE = 5, PEER_GONE = 6, END = 10 };
enum { WAIT_MS = 5000 };

struct Link {
    int fd;
    int is_hub;
    uint8_t buffer[1 << 16];
    size_t begin, end;
};

void fail(int status, const char *format, ...)
{
    va_list values;
    va_start(values, format);
    fputs("controller: ", stderr);
    vfprintf(stderr, format, values);
    fputc('\n', stderr);
    va_end(values);
    exit(status);
}

static void put(uint8_t *at, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        at[i] = (uint8_t)(value >> (8 * i));
}

static uint64_t get(const uint8_t *at, int bytes)
{
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++)
        value |= (uint64_t)at[i] << (8 * i);
    return value;
}

static void write_all(Link *link, const uint8_t *data, size_t size)
{
    for (int waited_ms = 0; size > 0;) {
        ssize_t sent = send(link->fd, data, size, MSG_NOSIGNAL);
        if (sent > 0) {
            data += sent;
            size -= (size_t)sent;
        } else if (errno == ENOBUFS && waited_ms++ < WAIT_MS) {
            usleep(1000); /* a transmit queue is full; poll() would call it writable */
        } else if (errno != EINTR) {
            fail(BENCH_LOST, "the bus takes no frames: %s", strerror(errno));
        }
    }
}

/* Read what is there; 0 when there is nothing yet. */
static int fill(Link *link)
{
    if (link->begin > 0) {
        memmove(link->buffer, link->buffer + link->begin, link->end - link->begin);
        link->end -= link->begin;
        link->begin = 0;
    }
    ssize_t got = recv(link->fd, link->buffer + link->end, sizeof link->buffer - link->end, MSG_DONTWAIT);
    if (got == 0)
        fail(BENCH_LOST, "the hub has gone");
    if (got < 0 && errno != EAGAIN && errno != EINTR)
        fail(BENCH_LOST, "the bus is gone: %s", strerror(errno));
    if (got > 0)
        link->end += (size_t)got;
    return got > 0;
}

/* The next whole record of a hub, or NULL. It stays valid until the next call. */
static const uint8_t *record(Link *link)
{
    for (;;) {
        size_t there = link->end - link->begin;
        size_t size = there >= 2 ? (size_t)get(link->buffer + link->begin, 2) : 0;
        if (there >= 2 && size < HEAD)
            fail(BENCH_LOST, "the hub sends what is no record");
        if (size && there >= size) {
            const uint8_t *found = link->buffer + link->begin;
            link->begin += size;
            return found;
        }
        if (!fill(link))
            return NULL;
    }
}

static void say_hello(Link *link, const char *token, const char *name)
{
    uint8_t hello[1024] = { 0 };
    int size = snprintf((char *)hello + HEAD, sizeof hello - HEAD,
                        "{\"protocol\": 1, \"name\": \"%s\", \"fixed_name\": true, \"pid\": %d, \"role\": \"member\","
                        " \"echo\": false, \"listen\": true, \"stamps\": true, \"token\": \"%s\"}",
                        name, (int)getpid(), token);
    put(hello, (uint64_t)(HEAD + size), 2);
    hello[2] = HELLO;
    write_all(link, hello, (size_t)(HEAD + size));
    const uint8_t *answer;
    while (!(answer = record(link))) {
        struct pollfd ready = { link->fd, POLLIN, 0 };
        if (poll(&ready, 1, WAIT_MS) <= 0)
            fail(BENCH_LOST, "the hub gives no answer");
    }
    if (answer[2] != WELCOME)
        fail(BENCH_LOST, "the hub refused: %.*s", (int)(get(answer, 2) - HEAD), (const char *)answer + HEAD);
}

static void open_hub(Link *link, const char *where, const char *token_file, const char *name)
{
    char token[256] = "";
    char host[64];
    int port;
    struct sockaddr_in address = { .sin_family = AF_INET };
    if (sscanf(where, "%63[^:]:%d", host, &port) != 2 || inet_pton(AF_INET, host, &address.sin_addr) != 1)
        fail(OWN_FAULT, "%s is no HOST:PORT", where);
    address.sin_port = htons((uint16_t)port);
    FILE *file = token_file ? fopen(token_file, "r") : NULL;
    if (token_file && (!file || !fgets(token, sizeof token, file)))
        fail(OWN_FAULT, "the token cannot be read from %s", token_file);
    if (file)
        fclose(file);
    token[strcspn(token, "\r\n")] = '\0';
    link->fd = socket(AF_INET, SOCK_STREAM, 0);
    if (link->fd < 0 || connect(link->fd, (struct sockaddr *)&address, sizeof address) < 0)
        fail(BENCH_LOST, "no hub listens at %s: %s", where, strerror(errno));
    setsockopt(link->fd, IPPROTO_TCP, TCP_NODELAY, &(int){ 1 }, sizeof(int));
    link->is_hub = 1;
    say_hello(link, token, name);
}

static void open_socketcan(Link *link, const char *name)
{
    struct ifreq asked = { 0 };
    struct sockaddr_can address = { .can_family = AF_CAN };
    link->fd = socket(AF_CAN, SOCK_RAW, CAN_RAW);
    if (link->fd < 0)
        fail(OWN_FAULT, "this kernel has no CAN: %s", strerror(errno));
    if (strlen(name) >= IFNAMSIZ)
        fail(OWN_FAULT, "%s is no name of a link", name);
    strcpy(asked.ifr_name, name);
    if (ioctl(link->fd, SIOCGIFINDEX, &asked) < 0)
        fail(OWN_FAULT, "there is no link %s: %s", name, strerror(errno));
    if (setsockopt(link->fd, SOL_SOCKET, SO_RCVBUFFORCE, &(int){ 1 << 22 }, sizeof(int)) < 0) /* root's only */
        setsockopt(link->fd, SOL_SOCKET, SO_RCVBUF, &(int){ 1 << 22 }, sizeof(int));
    address.can_ifindex = asked.ifr_ifindex;
    if (bind(link->fd, (struct sockaddr *)&address, sizeof address) < 0)
        fail(OWN_FAULT, "%s does not open: %s", name, strerror(errno));
}

Link *link_open(const char *text, const char *token_file, const char *name)
{
    Link *link = calloc(1, sizeof *link);
    if (!link)
        fail(OWN_FAULT, "no memory");
    if (!strncmp(text, "tcp:", 4))
        open_hub(link, text + 4, token_file, name);
    else if (!strncmp(text, "socketcan:", 10))
        open_socketcan(link, text + 10);
    else
        fail(OWN_FAULT, "%s is neither tcp:HOST:PORT nor socketcan:NAME", text);
    return link;
}

int link_fd(const Link *link)
{
    return link->fd;
}

void link_send(Link *link, const Frame *frames, int count, double stamp_s)
{
    uint8_t records[RECORD * 64];
    if (count > 64)
        fail(OWN_FAULT, "%d frames at once", count);
    for (int i = 0; i < count; i++) {
        struct can_frame frame = { .can_id = frames[i].id, .len = frames[i].length };
        memcpy(frame.data, frames[i].data, 8);
        uint8_t *at = records + RECORD * i;
        memset(at, 0, RECORD);
        put(at, RECORD, 2);
        at[2] = FRAME;
        put(at + 12, (uint64_t)(stamp_s * 1e9 + 0.5), 8);
        memcpy(at + HEAD, &frame, sizeof frame); /* little-endian machines only, as SocketCAN's own layout is native */
        if (!link->is_hub)
            write_all(link, (const uint8_t *)&frame, sizeof frame);
    }
    if (link->is_hub && count > 0)
        write_all(link, records, (size_t)(RECORD * count));
}

static int take_socketcan(Link *link, Frame *frame)
{
    struct can_frame raw;
    for (;;) {
        ssize_t got = recv(link->fd, &raw, sizeof raw, MSG_DONTWAIT);
        if (got < 0 && (errno == EAGAIN || errno == EINTR))
            return 0;
        if (got != (ssize_t)sizeof raw)
            fail(BENCH_LOST, "the bus is gone: %s", got < 0 ? strerror(errno) : "what it gives is no CAN frame");
        if (!(raw.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_ERR_FLAG)))
            break;
    }
    frame->id = raw.can_id;
    frame->length = raw.len;
    memcpy(frame->data, raw.data, 8);
    return 1;
}

int link_take(Link *link, Frame *frame)
{
    const uint8_t *found;
    struct can_frame raw;
    if (!link->is_hub)
        return take_socketcan(link, frame);
    while ((found = record(link))) {
        if (found[2] == PEER_GONE || found[2] == END || found[2] == BYE)
            fail(BENCH_LOST, "the bench ends: %.*s", (int)(get(found, 2) - HEAD), (const char *)found + HEAD);
        if (found[2] != FRAME || get(found, 2) != RECORD)
            continue;
        memcpy(&raw, found + HEAD, sizeof raw);
        if (raw.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_ERR_FLAG))
            continue;
        frame->id = raw.can_id;
        frame->length = raw.len;
        memcpy(frame->data, raw.data, 8);
        return 1;
    }
    return 0;
}
