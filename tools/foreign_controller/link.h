/* One CAN channel: of a hub over loopback TCP, or a SocketCAN link. Errors end the process with words and a status. */
#ifndef LINK_H
#define LINK_H

#include <stdint.h>

typedef struct {
    uint32_t id;      /* 11-bit identifier */
    uint8_t length;   /* bytes of data, 0 to 8 */
    uint8_t data[8];
} Frame;

typedef struct Link Link;

/* text: "tcp:127.0.0.1:PORT" (token_file: the hub's, 0600) or "socketcan:NAME"; name: what the hub calls us. */
Link *link_open(const char *text, const char *token_file, const char *name);

/* To wait on with poll(). */
int link_fd(const Link *link);

/* In this order, stamped with stamp_s (virtual time; SocketCAN has no place for it). */
void link_send(Link *link, const Frame *frames, int count, double stamp_s);

/* The next frame that has arrived: 1, or 0 when there is none yet. Does not wait. */
int link_take(Link *link, Frame *frame);

enum { OWN_FAULT = 1, BENCH_LOST = 3 };

/* Print `controller: ...` to stderr and end with this status; BENCH_LOST: the others know why. */
_Noreturn void fail(int status, const char *format, ...);

#endif
