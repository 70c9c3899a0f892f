
#define TOUCH_UNKNOWN -1 /* label of a touch that is unlike all gestures */
#define TOUCH_REPORTED 1 /* news: an event is reported, its label is another one, it is over */
#define TOUCH_CHANGED 2
#define TOUCH_ENDED 3
#define TOUCH_OK 0        /* status */
#define TOUCH_REFUSED 1   /* the last frames are unlike training */
#define TOUCH_SATURATED 2 /* a tenth of the taxels, or more, are at full scale in the last frame */

/* An event: its label so far, mean probability of the label, and frames seen when it was reported and when it ended.
   Frames are counted from touch_watch_init, modulo 2^32; end is 0 while the touch lasts. */
typedef struct {
    int label;
    float confidence;
    uint32_t reported, end;
} touch_event_t;

#define touch_watch_init touch_watch_init_$model

/* Begin to watch: once, at power-on. The state is all the memory that is needed; it holds that of a capture, too. */
int touch_watch_init(touch_watch_t *w);

/* Take a frame of an endless stream, as touch_push does: 0 without news, TOUCH_REPORTED, TOUCH_CHANGED or TOUCH_ENDED
   with news, which the event then tells, or a code. A frame that is refused changes only the status and its counts. A
   touch that is over before it was reported is news once, TOUCH_ENDED. News come TOUCH_DELAY frames after the frame that
   decides, as the work is spread over these; the times of an event are those of its news. */
int touch_watch(touch_watch_t *w, const float *frame, touch_event_t *event);

/* So many frames are lost before the next one. Up to a second of them count as if the last frame were read again, and
   take as long; after more, a touch that lasts is over and the stream begins anew. Returns the last news. */
int touch_missed(touch_watch_t *w, uint32_t frames, touch_event_t *event);

/* Whether touches may be missed or named wrongly now: 0, or the bits of all reasons; or a code. counts may be NULL. */
int touch_status(const touch_watch_t *w, touch_counts_t *counts);

/* What a bit of the status means, from bit 0, in a word. */
const char *touch_reason(int bit);
