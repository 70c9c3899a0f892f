/* What the taxels did in a part of a window. */
typedef struct {
    int n;
    float mean[$TAXELS], m2[$TAXELS], most[$TAXELS];
} touch_part_t;

