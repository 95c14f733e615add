// A client of the station's REST interface in one file, without further packages: copy it into your project.
// .NET Framework 4.7.2, Mono 6, .NET 6 and newer. The first two need the references System.Net.Http and
// System.Runtime.Serialization. Guide: docs/rest.md; a program that uses it: Tester.cs.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Net.Http;
using System.Net.Http.Headers;
using System.Net.Security;
using System.Runtime.Serialization;
using System.Runtime.Serialization.Json;
using System.Security.Cryptography.X509Certificates;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace Vaoi
{
    /// <summary>A refusal of the station (RFC 9457). Decide by Code; show Message and Action to operators.</summary>
    public sealed class StationException : Exception
    {
        public readonly int Status;
        public readonly string Code, Action;
        /// <summary>When the station suggests to try again; null if it does not.</summary>
        public readonly TimeSpan? RetryAfter;

        public StationException(Problem problem, TimeSpan? retryAfter) : base(problem.Detail)
        {
            Status = problem.Status;
            Code = problem.Code;
            Action = problem.Action;
            RetryAfter = retryAfter;
        }
    }

    /// <summary>A connection to one station, for any number of threads. Keep one as long as the program runs: it keeps
    /// its connections open. Every method throws StationException for a refusal, and HttpRequestException if the
    /// station does not reply.</summary>
    public sealed class VaoiStation : IDisposable
    {
        private const int Attempts = 4;
        private readonly HttpClient http;

        /// <param name="address">For example http://127.0.0.1:8350.</param>
        /// <param name="key">The key, needed from other machines than the station's.</param>
        /// <param name="certificate">PEM file of the station's certificate, which is trusted although no authority of
        /// the system signed it.</param>
        public VaoiStation(string address, string key = null, string certificate = null)
        {
            // No proxy: the station is on this machine or in the factory's own network.
            var handler = new HttpClientHandler { UseProxy = false, AllowAutoRedirect = false };
            if (certificate != null)
            {
                byte[] known = new X509Certificate2(certificate).RawData;
                handler.ServerCertificateCustomValidationCallback = (request, shown, chain, errors) =>
                    errors == SslPolicyErrors.None || (shown != null && shown.RawData.SequenceEqual(known));
            }
            // Longer than the longest long poll (60 s) and the longest wait for a board that passes.
            http = new HttpClient(handler) { BaseAddress = new Uri(address.TrimEnd('/') + "/"), Timeout = TimeSpan.FromSeconds(150) };
            if (key != null) http.DefaultRequestHeaders.Authorization = new AuthenticationHeaderValue("Bearer", key);
        }

        public void Dispose() { http.Dispose(); }

        public Task<StationState> State() { return Read<StationState>(HttpMethod.Get, "station"); }

        /// <summary>Film every board from now on, or the next `runs` boards. A board that is passing keeps the order
        /// before; `passing` says what this request does meanwhile: wait, after or refuse.</summary>
        public Task<StationState> Arm(
            string boardType, string boardId = null, string jobId = null, int? runs = null, string passing = null)
        {
            return Read<StationState>(HttpMethod.Post, "station/arm" + Query(
                "board_type", boardType, "board_id", boardId, "job_id", jobId, "runs", runs, "passing", passing));
        }

        public Task<StationState> Disarm() { return Read<StationState>(HttpMethod.Post, "station/disarm"); }

        public Task<Run> Run(string id) { return Read<Run>(HttpMethod.Get, "runs/" + id); }

        /// <summary>Return the run that finished last; null before the first.</summary>
        public async Task<Run> LatestRun()
        {
            try { return await Run("latest").ConfigureAwait(false); }
            catch (StationException refused) when (refused.Code == "no-run-yet") { return null; }
        }

        /// <summary>Wait for the first run that finishes after the run `after` (null: from now on). Return null when
        /// `seconds` (at most 60) have passed: ask again.</summary>
        public Task<Run> NextRun(string after, int seconds = 30, CancellationToken cancel = default(CancellationToken))
        {
            string path = "runs/next" + Query("after", after, "timeout", seconds);
            return Read<Run>(HttpMethod.Get, path, cancel);
        }

        public Task<Matrices> Matrices(string run) { return Read<Matrices>(HttpMethod.Get, "runs/" + run + "/matrices"); }

        public async Task<ComponentSummary[]> Components(string run)
        {
            return (await Read<ComponentList>(HttpMethod.Get, "runs/" + run + "/components").ConfigureAwait(false)).Components;
        }

        /// <summary>Return the views of one component (`ref`, on a panel `panel/ref`), best first. `options` are pairs
        /// of name and value, for example "light", "left", "limit", 3: docs/rest.md, choosing images.</summary>
        public Task<ComponentViews> Component(string run, string component, params object[] options)
        {
            return Read<ComponentViews>(HttpMethod.Get, "runs/" + run + "/components/" + Path(component) + Query(options));
        }

        public Task<BoardType> BoardType(string name)
        {
            return Read<BoardType>(HttpMethod.Get, "board-types/" + Uri.EscapeDataString(name));
        }

        /// <summary>Return where the board lies that the tester has clamped, and the points that it asks for.</summary>
        public Task<Clamped> Clamped(string run, ClampedRequest asked)
        {
            return Read<Clamped>(HttpMethod.Post, "runs/" + run + "/clamped", default(CancellationToken), Bytes(asked));
        }

        /// <summary>Return the pixels of a view.</summary>
        public async Task<Picture> Picture(View view)
        {
            using (var reply = await Send(HttpMethod.Get, With(view.Url, "format=raw")).ConfigureAwait(false))
            {
                byte[] pixels = await reply.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
                Func<string, string> header = name => reply.Headers.GetValues(name).First();
                Func<string, int> number = name => int.Parse(header(name), CultureInfo.InvariantCulture);
                return new Picture(number("X-Image-Width"), number("X-Image-Height"), number("X-Image-Channels"),
                    header("X-Image-Dtype"), pixels);
            }
        }

        /// <summary>Return the picture of a view as a file: png, jpeg, tiff or npy.</summary>
        public async Task<byte[]> PictureFile(View view, string format = "png")
        {
            using (var reply = await Send(HttpMethod.Get, With(view.Url, "format=" + format)).ConfigureAwait(false))
                return await reply.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
        }

        /// <summary>Read the pictures of many components (none named: of all) in one request. `each` is called with
        /// every component as soon as its pictures have arrived. Pixels are read raw, so `options` state no format: a
        /// JPEG is `PictureFile(view, "jpeg")`.</summary>
        public async Task Pictures(string run, string[] components, Action<ComponentPictures> each, params object[] options)
        {
            var named = (components ?? new string[0]).SelectMany(c => new object[] { "component", c });
            string query = Query(named.Concat(new object[] { "format", "raw" }).Concat(options).ToArray());
            string path = "runs/" + run + "/images" + query;
            using (var reply = await Send(HttpMethod.Get, path, HttpCompletionOption.ResponseHeadersRead).ConfigureAwait(false))
            using (var stream = await reply.Content.ReadAsStreamAsync().ConfigureAwait(false))
            using (var buffered = new BufferedStream(stream, 1 << 18))
                await Task.Run(() => new Batch(buffered).Read(each)).ConfigureAwait(false);
        }

        /// <summary>Keep the frames of a run in memory until Release with the same holder.</summary>
        public Task Hold(string run, string holder) { return Do(HttpMethod.Put, "runs/" + run + "/hold", "holder", holder); }

        /// <summary>Give up the frames of a run, so that a later board can use their memory; the result is kept.</summary>
        public Task Release(string run, string holder = null)
        {
            return Do(HttpMethod.Post, "runs/" + run + "/release", "holder", holder);
        }

        private async Task Do(HttpMethod method, string path, params object[] query)
        {
            (await Send(method, path + Query(query)).ConfigureAwait(false)).Dispose();
        }

        private async Task<T> Read<T>(
            HttpMethod method, string path, CancellationToken cancel = default(CancellationToken), byte[] document = null)
            where T : class
        {
            using (var reply = await Send(method, path, cancel: cancel, document: document).ConfigureAwait(false))
            {
                byte[] body = await reply.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
                return body.Length == 0 ? null : Json<T>(body);
            }
        }

        /// <summary>Send a request, and repeat it if the connection breaks or the station is busy for a moment. A
        /// command has a key that is the same in all repetitions, so that it acts once.</summary>
        private async Task<HttpResponseMessage> Send(
            HttpMethod method, string path, HttpCompletionOption until = HttpCompletionOption.ResponseContentRead,
            CancellationToken cancel = default(CancellationToken), byte[] document = null)
        {
            string key = method == HttpMethod.Get ? null : "\"" + Guid.NewGuid() + "\"";
            string address = path.StartsWith("/") ? path : "api/v1/" + path;
            for (int attempt = 1; ; attempt++)
            {
                TimeSpan pause = TimeSpan.FromMilliseconds(200 * attempt);
                try
                {
                    var request = new HttpRequestMessage(method, address);
                    if (key != null) request.Headers.Add("Idempotency-Key", key);
                    if (document != null)
                    {
                        request.Content = new ByteArrayContent(document);
                        request.Content.Headers.ContentType = new MediaTypeHeaderValue("application/json");
                    }
                    var reply = await http.SendAsync(request, until, cancel).ConfigureAwait(false);
                    if (reply.IsSuccessStatusCode) return reply;
                    using (reply) throw await Refusal(reply).ConfigureAwait(false);
                }
                catch (HttpRequestException) when (attempt < Attempts) { }
                catch (StationException refused)
                    when (attempt < Attempts && (refused.Code == "busy" || refused.Code == "request-under-way"))
                {
                    pause = refused.RetryAfter ?? pause;
                }
                await Task.Delay(pause, cancel).ConfigureAwait(false);
            }
        }

        private static async Task<StationException> Refusal(HttpResponseMessage reply)
        {
            byte[] body = await reply.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
            var type = reply.Content.Headers.ContentType;
            var problem = type != null && type.MediaType == "application/problem+json"
                ? Json<Problem>(body)
                : new Problem { Status = (int)reply.StatusCode, Code = "unusable-reply", Action = "Check the address.",
                    Detail = "Another program than a station replied with status " + (int)reply.StatusCode + "." };
            return new StationException(problem, reply.Headers.RetryAfter?.Delta);
        }

        internal static T Json<T>(byte[] body)
        {
            var settings = new DataContractJsonSerializerSettings { UseSimpleDictionaryFormat = true };
            return (T)new DataContractJsonSerializer(typeof(T), settings).ReadObject(new MemoryStream(body));
        }

        private static byte[] Bytes<T>(T document)
        {
            var stream = new MemoryStream();
            new DataContractJsonSerializer(typeof(T)).WriteObject(stream, document);
            return stream.ToArray();
        }

        private static string With(string url, string option) { return url + (url.Contains("?") ? "&" : "?") + option; }

        private static string Path(string address) { return string.Join("/", address.Split('/').Select(Uri.EscapeDataString)); }

        private static string Query(params object[] pairs)
        {
            var query = new StringBuilder();
            for (int i = 0; i + 1 < pairs.Length; i += 2)
                if (pairs[i + 1] != null)
                    query.Append(query.Length == 0 ? '?' : '&').Append(pairs[i]).Append('=').Append(Uri.EscapeDataString(
                        pairs[i + 1] is bool ? ((bool)pairs[i + 1] ? "true" : "false")
                            : Convert.ToString(pairs[i + 1], CultureInfo.InvariantCulture)));
            return query.ToString();
        }
    }

    /// <summary>Reads the answer to `runs/{id}/images`: files in a multipart body, each with its length.</summary>
    internal sealed class Batch
    {
        private readonly Stream stream;

        public Batch(Stream stream) { this.stream = stream; }

        public void Read(Action<ComponentPictures> each)
        {
            var begun = new Dictionary<string, ComponentPictures>();
            string boundary = Line();
            for (string line = boundary; line == boundary; line = Line())
            {
                int length = 0;
                string name = "";
                for (string header = Line(); header.Length > 0; header = Line())
                {
                    if (header.StartsWith("Content-Length: ")) length = int.Parse(header.Substring(16));
                    if (header.StartsWith("Content-Disposition: ")) name = header.Split('"')[1];
                }
                byte[] content = Exactly(length);
                Line(); // the end of the content
                if (name == "end.json")
                {
                    var end = VaoiStation.Json<BatchEnd>(content);
                    if (end.Complete) return;
                    throw new StationException(
                        new Problem { Status = 200, Code = end.Error.Code, Detail = end.Error.Message, Action = end.Error.Action },
                        null);
                }
                string folder = name.Substring(0, Math.Max(0, name.LastIndexOf('/')));
                ComponentPictures component;
                if (name.EndsWith("/views.json"))
                    begun[folder] = component = VaoiStation.Json<ComponentPictures>(content);
                else if (begun.TryGetValue(folder, out component))
                    component.Add(content);
                if (component != null && component.Pictures.Count == component.Views.Length)
                {
                    begun.Remove(folder);
                    each(component);
                }
            }
            throw new IOException("The answer of the station ended early.");
        }

        private string Line()
        {
            var line = new StringBuilder();
            for (int c = stream.ReadByte(); c != '\n'; c = stream.ReadByte())
            {
                if (c < 0) throw new IOException("The answer of the station ended early.");
                line.Append((char)c);
            }
            return line.ToString().TrimEnd('\r');
        }

        private byte[] Exactly(int length)
        {
            var content = new byte[length];
            for (int done = 0; done < length;)
            {
                int more = stream.Read(content, done, length - done);
                if (more == 0) throw new IOException("The answer of the station ended early.");
                done += more;
            }
            return content;
        }
    }

    /// <summary>Pixels, line after line without gaps; 16-bit values have the low byte first; colours are red, green, blue.</summary>
    public sealed class Picture
    {
        public readonly int Width, Height, Channels, BytesPerValue;
        public readonly byte[] Pixels;

        internal Picture(int width, int height, int channels, string type, byte[] pixels)
        {
            Width = width;
            Height = height;
            Channels = channels;
            BytesPerValue = type == "uint16" ? 2 : 1;
            Pixels = pixels;
            if (pixels.Length != width * height * channels * BytesPerValue)
                throw new IOException("A picture has " + pixels.Length + " bytes, which does not fit its size.");
        }

        public int this[int x, int y, int channel = 0]
        {
            get
            {
                int at = ((y * Width + x) * Channels + channel) * BytesPerValue;
                return BytesPerValue == 1 ? Pixels[at] : Pixels[at] | Pixels[at + 1] << 8;
            }
        }
    }

    // The replies, with the fields that most programs need. Fields that the station adds are ignored; further fields of
    // the OpenAPI document can be added here. Optional values are null where the reply does not have them.

    [DataContract]
    public sealed class Problem
    {
        [DataMember(Name = "status")] public int Status;
        [DataMember(Name = "code")] public string Code;
        [DataMember(Name = "detail")] public string Detail;
        [DataMember(Name = "action")] public string Action;
    }

    [DataContract]
    public sealed class Reason
    {
        [DataMember(Name = "code")] public string Code;
        [DataMember(Name = "message")] public string Message;
        [DataMember(Name = "action")] public string Action;
    }

    [DataContract]
    public sealed class StationState
    {
        [DataMember(Name = "state")] public string State;
        [DataMember(Name = "line_ready")] public bool LineReady;
        [DataMember(Name = "all_cameras_ready")] public bool AllCamerasReady;
        [DataMember(Name = "boards_missed")] public int BoardsMissed;
        [DataMember(Name = "reasons")] public Reason[] Reasons;
        [DataMember(Name = "warnings")] public Reason[] Warnings;
    }

    [DataContract]
    public sealed class Run
    {
        [DataMember(Name = "id")] public string Id;
        [DataMember(Name = "state")] public string State;
        [DataMember(Name = "verdict")] public string Verdict;
        [DataMember(Name = "board_type")] public string BoardType;
        [DataMember(Name = "board_id")] public string BoardId;
        [DataMember(Name = "job_id")] public string JobId;
        [DataMember(Name = "frames_available")] public bool FramesAvailable;
        [DataMember(Name = "reasons")] public Reason[] Reasons;
    }

    [DataContract]
    public sealed class Matrices
    {
        /// <summary>M_ij, 3 x 3, tester to image, by camera and row; null where a frame could not be placed.</summary>
        [DataMember(Name = "image_matrices")] public double[][][][] Image;
        /// <summary>C, CAD to tester; null if it is unknown.</summary>
        [DataMember(Name = "cad_matrix")] public double[][] Cad;
        /// <summary>C of each component that its local fiducials place, by address; null if there is none.</summary>
        [DataMember(Name = "local_matrices")] public Dictionary<string, double[][]> Local;
        /// <summary>C of each board of a panel that its fiducials place, by position; null if there is none.</summary>
        [DataMember(Name = "board_matrices")] public Dictionary<string, double[][]> Boards;
        /// <summary>Positions of the boards of a panel that are crossed out; null if none is.</summary>
        [DataMember(Name = "skipped_boards")] public string[] Skipped;
        [DataMember(Name = "row_motion")] public double[][][] RowMotion;
        [DataMember(Name = "status")] public string Status;
        [DataMember(Name = "reasons")] public string[] Reasons;
        [DataMember(Name = "reason_codes")] public string[] ReasonCodes;

        /// <summary>CAD to tester for one component, by its address: its own C where local fiducials place it,
        /// that of its board on a panel, else C.</summary>
        public double[][] CadOf(string component)
        {
            double[][] own;
            if (Local != null && Local.TryGetValue(component, out own)) return own;
            int end = component.IndexOf('/');
            return Boards != null && end > 0 && Boards.TryGetValue(component.Substring(0, end), out own) ? own : Cad;
        }
    }

    [DataContract]
    internal sealed class ComponentList { [DataMember(Name = "components")] public ComponentSummary[] Components = null; }

    [DataContract]
    public sealed class ComponentSummary
    {
        [DataMember(Name = "address")] public string Address;
        [DataMember(Name = "tester_mm")] public double[] TesterMm;
        [DataMember(Name = "views")] public int Views;
        [DataMember(Name = "unseen")] public bool Unseen;
        /// <summary>Whether its board on the panel is crossed out.</summary>
        [DataMember(Name = "skipped")] public bool Skipped;
    }

    [DataContract]
    public sealed class View
    {
        [DataMember(Name = "k")] public int K;
        [DataMember(Name = "camera")] public int Camera;
        [DataMember(Name = "row")] public int Row;
        [DataMember(Name = "coverage")] public double Coverage;
        [DataMember(Name = "px_per_mm")] public double PxPerMm;
        [DataMember(Name = "width_px")] public int WidthPx;
        [DataMember(Name = "height_px")] public int HeightPx;
        [DataMember(Name = "exposure_us")] public double? ExposureUs;
        [DataMember(Name = "light")] public string Light;
        [DataMember(Name = "sigma_px")] public double? SigmaPx;
        /// <summary>CAD coordinates to pixels of the picture, 3 x 3, and pixels of the picture to those of the frame.</summary>
        [DataMember(Name = "crop_from_cad")] public double[][] CropFromCad;
        [DataMember(Name = "cad_from_crop")] public double[][] CadFromCrop;
        [DataMember(Name = "image_from_crop")] public double[][] ImageFromCrop;
        [DataMember(Name = "url")] public string Url;
        [DataMember(Name = "dtype")] internal string Type;
        [DataMember(Name = "channels")] internal int Channels;
    }

    [DataContract]
    public sealed class ComponentViews
    {
        [DataMember(Name = "views")] public View[] Views;
        [DataMember(Name = "remark")] public string Remark;
    }

    [DataContract]
    public sealed class ComponentPictures
    {
        [DataMember(Name = "address")] public string Address;
        [DataMember(Name = "views")] public View[] Views;
        /// <summary>Why the component has no pictures; null if it was not refused.</summary>
        [DataMember(Name = "refused")] public Reason Refused;
        /// <summary>The pictures of the views.</summary>
        public List<Picture> Pictures { get; private set; }

        internal void Add(byte[] pixels)
        {
            View view = Views[Pictures.Count];
            Pictures.Add(new Picture(view.WidthPx, view.HeightPx, view.Channels, view.Type, pixels));
        }

        [OnDeserialized]
        private void Prepare(StreamingContext context) { Pictures = new List<Picture>(); }
    }

    [DataContract]
    public sealed class BoardType
    {
        [DataMember(Name = "name")] public string Name;
        [DataMember(Name = "unit")] public string Unit;
        [DataMember(Name = "fiducials")] public Fiducial[] Fiducials;
    }

    /// <summary>A fiducial, in CAD coordinates and the unit of the board type.</summary>
    [DataContract]
    public sealed class Fiducial
    {
        [DataMember(Name = "name")] public string Name;
        [DataMember(Name = "x")] public double X;
        [DataMember(Name = "y")] public double Y;
    }

    /// <summary>A fiducial where the tester has found it.</summary>
    [DataContract]
    public sealed class Reading
    {
        [DataMember(Name = "fiducial")] public string Fiducial;
        [DataMember(Name = "x")] public double X;
        [DataMember(Name = "y")] public double Y;
        [DataMember(Name = "z", EmitDefaultValue = false)] public double? Z;
    }

    /// <summary>The readings, and what is asked for; lengths are in Unit. Null values are not sent.</summary>
    [DataContract]
    public sealed class ClampedRequest
    {
        [DataMember(Name = "readings")] public Reading[] Readings;
        [DataMember(Name = "sigma")] public double Sigma;
        [DataMember(Name = "sigma_z", EmitDefaultValue = false)] public double? SigmaZ;
        [DataMember(Name = "unit")] public string Unit = "mm";
        [DataMember(Name = "y_axis")] public string YAxis = "up";
        [DataMember(Name = "turn_deg", EmitDefaultValue = false)] public double? TurnDeg;
        [DataMember(Name = "points", EmitDefaultValue = false)] public string[] Points;
        [DataMember(Name = "nets", EmitDefaultValue = false)] public string[] Nets;
        [DataMember(Name = "pads_of", EmitDefaultValue = false)] public string[] PadsOf;
        [DataMember(Name = "test_points")] public bool TestPoints;
        [DataMember(Name = "clearance", EmitDefaultValue = false)] public double? Clearance;
        [DataMember(Name = "margin")] public double Margin;
    }

    [DataContract]
    public sealed class Clamped
    {
        /// <summary>ok; degraded: usable, see the reasons; failed: there are no points.</summary>
        [DataMember(Name = "status")] public string Status;
        [DataMember(Name = "reasons")] public Reason[] Reasons;
        [DataMember(Name = "remarks")] public string[] Remarks;
        [DataMember(Name = "points")] public ClampedPoint[] Points;
        [DataMember(Name = "keep_outs")] public KeepOut[] KeepOuts;
    }

    [DataContract]
    public sealed class ClampedPoint
    {
        [DataMember(Name = "name")] public string Name;
        [DataMember(Name = "net")] public string Net;
        [DataMember(Name = "x")] public double X;
        [DataMember(Name = "y")] public double Y;
        [DataMember(Name = "z")] public double Z;
        [DataMember(Name = "sigma_x")] public double SigmaX;
        [DataMember(Name = "sigma_y")] public double SigmaY;
        [DataMember(Name = "sigma_z")] public double SigmaZ;
    }

    /// <summary>A body that the probe must not touch: a prism over the corners up to Top, which is null if the height
    /// is not known.</summary>
    [DataContract]
    public sealed class KeepOut
    {
        [DataMember(Name = "component")] public string Component;
        [DataMember(Name = "corners")] public double[][] Corners;
        [DataMember(Name = "top")] public double? Top;
    }

    [DataContract]
    internal sealed class BatchEnd
    {
        [DataMember(Name = "complete")] public bool Complete = false;
        [DataMember(Name = "error")] public Reason Error = null;
    }
}
