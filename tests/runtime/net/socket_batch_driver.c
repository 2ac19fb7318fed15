/* Puts random datagrams through the batch I/O, under the compiler's sanitizers: socket_batch.c is compiled together with this.
   Arguments: how many datagrams, and the seed. Exit status 0 when all that was sent came out, in order, and each echo once. */

#define _GNU_SOURCE
#include <sys/socket.h>

static ssize_t send_interrupted(int, const void *, size_t, int, const struct sockaddr *, socklen_t);
#define sendto send_interrupted /* by the batch I/O */
#include "socket_batch.c"
#undef sendto

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

enum { BATCH = 120, LONGEST_SENT = 1500 };

typedef struct {
    int length, own;
    uint8_t data[LONGEST_SENT];
} Datagram;

static Datagram queue[MOST_SOCKETS][BATCH];
static int sent[MOST_SOCKETS], seen[MOST_SOCKETS];

static void check(int good, const char *what) {
    if (!good) {
        fprintf(stderr, "%s\n", what);
        exit(1);
    }
}

static int interrupts; /* that the next sends meet */

static ssize_t send_interrupted(int from, const void *data, size_t length, int flags, const struct sockaddr *to, socklen_t size) {
    check(flags == (MSG_DONTWAIT | MSG_NOSIGNAL), "a send that may block");
    if (interrupts && interrupts--) {
        errno = EINTR;
        return -1;
    }
    return sendto(from, data, length, flags, to, size);
}

static int open_socket(struct sockaddr_in *address) {
    socklen_t size = sizeof *address;
    int made = socket(AF_INET, SOCK_DGRAM, 0), room = 1 << 20;
    *address = (struct sockaddr_in){.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    setsockopt(made, SOL_SOCKET, SO_RCVBUF, &room, sizeof room);
    check(made >= 0 && !bind(made, (struct sockaddr *)address, size), "no socket");
    check(!getsockname(made, (struct sockaddr *)address, &size), "no address");
    return made;
}

static void know(Inbox *inbox, int place, const struct sockaddr_in *address) {
    socket_batch_address(inbox, place, (const uint8_t *)address, (int32_t)sizeof *address);
}

/* A datagram that one socket gets, from a stranger or by our own sending: random, and now and then one to the group. */
static void send_one(Inbox *inbox, int from, int to, const struct sockaddr_in *address) {
    Datagram *made = &queue[to][sent[to]++];
    made->length = rand() % 4 ? rand() % LONGEST_SENT : rand() % 3 + LARGEST - 1;
    made->own = made->length >= 16 && rand() % 5 == 0; /* shorter ones may be like others */
    for (int i = 0; i < made->length; i++) made->data[i] = (uint8_t)rand();
    if (made->own) know(inbox, GROUP, address);
    interrupts = rand() % 4;
    if (made->own || rand() % 2) check(!socket_batch_send(inbox, made->own ? GROUP : to, made->data, made->length), "send");
    else check(sendto(from, made->data, (size_t)made->length, 0, (const struct sockaddr *)address, sizeof *address) >= 0, "send");
    made->own = made->own && made->length <= LARGEST;
}

/* Places that are none, addresses that are none. */
static void check_places(Inbox *inbox, const struct sockaddr_in *address) {
    static uint8_t large[sizeof(struct sockaddr_in6) + 1];
    int none[] = {-1, PLACES, INT32_MIN, INT32_MAX, 7};
    for (int i = 0; i < 5; i++) {
        if (i < 4) know(inbox, none[i], address);
        check(socket_batch_send(inbox, none[i], large, 1) == EDESTADDRREQ, "sent to no place");
    }
    for (int32_t size = -1; size <= (int32_t)sizeof large; size += (int32_t)sizeof large + 1) {
        know(inbox, 7, address);
        socket_batch_address(inbox, 7, large, size);
        check(socket_batch_send(inbox, 7, large, 1) == EDESTADDRREQ, "sent to no address");
    }
    large[0] = large[1] = UINT8_MAX;
    socket_batch_address(inbox, 7, large, (int32_t)sizeof large - 1);
    check(socket_batch_send(inbox, 7, large, 1) == EAFNOSUPPORT, "sent to an address of no kind");
    know(inbox, 7, address);
    check(socket_batch_send(inbox, 7, large, 70000) == EMSGSIZE, "too long");
}

/* Whether it is the next of one socket. */
static int is_next(int number, int32_t length, const uint8_t *data) {
    if (seen[number] == sent[number]) return 0;
    const Datagram *next = &queue[number][seen[number]];
    int cut = next->length < LARGEST ? next->length : LARGEST;
    if ((length == ECHO ? !next->own : length != cut) || memcmp(data, next->data, (size_t)cut)) return 0;
    seen[number]++;
    return 1;
}

static int take_all(Inbox *inbox, int32_t used) {
    for (int32_t i = 0; i < used; i++) {
        const uint8_t *slot = inbox->slots + (size_t)i * LARGEST;
        int32_t length = inbox->shown.length[i];
        check(length >= ECHO && length <= LARGEST, "length");
        check(is_next(0, length, slot) || is_next(1, length, slot), "not what was sent");
    }
    return used;
}

static void wait_and_see(Inbox *inbox, int32_t duration, int32_t expected, int32_t patience, int *taken) {
    const int32_t before = *taken ? 0 : inbox->shown.arrived;
    const int32_t found = socket_batch_wait(inbox, expected, *taken, duration, patience);
    check(found >= before && found == inbox->shown.arrived, "found");
    *taken = 0;
}

static int32_t receive(Inbox *inbox) {
    check(socket_batch_receive(inbox) == inbox->shown.arrived, "received");
    return inbox->shown.used;
}

int main(int count, char **arguments) {
    check(count == 3, "usage: socket_batch_driver DATAGRAMS SEED");
    int todo = atoi(arguments[1]), from, sockets[MOST_SOCKETS];
    struct sockaddr_in nobody, address[MOST_SOCKETS];
    Inbox *inbox = malloc(socket_batch_inbox_size());
    uint8_t *slots = malloc((size_t)MOST_AT_ONCE * LARGEST);
    srand((unsigned)atoi(arguments[2]));
    from = open_socket(&nobody);
    for (int i = 0; i < MOST_SOCKETS; i++) sockets[i] = open_socket(&address[i]);
    socket_batch_open(inbox, slots, sockets, MOST_SOCKETS, 0);
    for (int i = 0; i < MOST_SOCKETS; i++) know(inbox, i, &address[i]);
    check_places(inbox, &nobody);
    while (todo > 0) {
        int batch = rand() % BATCH, taken = 0, none = 1;
        memset(sent, 0, sizeof sent);
        memset(seen, 0, sizeof seen);
        for (int i = 0; i < batch; i++) {
            int to = rand() % MOST_SOCKETS;
            send_one(inbox, from, to, &address[to]);
            if (rand() % 8 == 0) wait_and_see(inbox, 0, 1 + rand() % 4, rand() % 3, &none);
        }
        if (rand() % 2) wait_and_see(inbox, 10 * (rand() % 3), batch, 100, &none);
        if (!none) taken += take_all(inbox, inbox->shown.used);
        while (taken < batch) taken += take_all(inbox, receive(inbox));
        check(taken == batch && !inbox->shown.errors, "too many");
        todo -= batch;
    }
    for (int i = 0; i < 100; i++) learn(inbox, 1, now()); /* what came had come before */
    check(inbox->shown.pace == SHORT_PACE, "pace");
    socket_batch_close(inbox);
    check(!receive(inbox) && !socket_batch_wait(inbox, 1, 1, 0, 0), "closed");
    check(socket_batch_send(inbox, 0, slots, 1) == EBADF, "closed, and sends");
    for (int i = 0; i < MOST_SOCKETS; i++) close(sockets[i]);
    close(from);
    free(slots);
    free(inbox);
    return 0;
}
